"""What the running node costs, as ratios to a bare rclpy relay: `python benchmarks/cost.py`.

CPU per message, latency, start and memory, one after another, in about five minutes; each is a
program of its own that can be run for longer.
"""

from __future__ import annotations

import os
import subprocess
import sys

from stage import HERE

PARTS = (
    ("throughput.py", "10"),
    ("latency.py", "16"),
    ("start.py", "7"),
    ("memory.py", "2e5"),
)


def main() -> None:
    for domain, (program, size) in enumerate(PARTS, start=50):
        # Messages of the previous part must not be received by the next.
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
        subprocess.run([sys.executable, str(HERE / program), size], check=True, env=environment)
        print()


if __name__ == "__main__":
    main()
