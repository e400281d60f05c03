"""The command `magcal`: argparse and printing."""

from magcal_ros.processes import use_one_thread

# Here, because every command loads numpy.
use_one_thread()
