"""Whether the verdict is correct: `python benchmarks/honesty.py [--runs N] [--seed S]`.

Random turns, good and bad, are fitted and judged. What counts is a *miss*: a calibration accepted
without a warning whose heading on the level is wrong by more than five times what it predicts, or
by more than three degrees. Hidden cases are those that the samples cannot show, such as a
mirrored magnetometer where there is no gyro; their misses are shown, but separately.
"""

from __future__ import annotations

import argparse

import shared_cases  # noqa: F401
from honesty_cases import KINDS, Row, draw_case


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    rows: dict[str, Row] = {kind: Row() for kind in KINDS}
    for number in range(arguments.runs):
        kind, case = draw_case(arguments.seed, number)
        rows[kind].run(case, f"{kind}, seed {arguments.seed}, case {number}")
    print_table(rows)


def print_table(rows: dict[str, Row]) -> None:
    names = ("runs", "refused", "warned", "accepted", "misses", "hidden", "broken")
    print(f"\n{'kind':24s}" + "".join(f"{name:>10s}" for name in names) + "   slowest s")
    for kind, row in rows.items():
        counts = "".join(f"{getattr(row, name):10d}" for name in names)
        print(f"{kind:24s}{counts}{row.slowest:12.2f}")
    total = {name: sum(getattr(row, name) for row in rows.values()) for name in names}
    print(f"{'all':24s}" + "".join(f"{total[name]:10d}" for name in names))
    print(f"unflagged misses {100.0 * total['misses'] / max(total['runs'], 1):.3f} % of all runs")


if __name__ == "__main__":
    main()
