"""The command `magcal`: argparse and printing."""

from magcal_ros.processes import use_one_thread

# Called here, because every command imports numpy.
use_one_thread()
