"""Puts `cases/` on the path: the simulated robots and recorded drives that tests use, too."""

import sys
from pathlib import Path

sys.path.insert(1, str(Path(__file__).resolve().parents[1] / "cases"))
