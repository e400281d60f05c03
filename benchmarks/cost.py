"""What the running node costs, as ratios to a bare rclpy relay: `python benchmarks/cost.py`.

CPU per message, latency, start and memory, one after another, in about five minutes; each is a
program of its own that can be run for longer.
"""

from __future__ import annotations

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
    for program, size in PARTS:
        subprocess.run([sys.executable, str(HERE / program), size], check=True)
        print()


if __name__ == "__main__":
    main()
