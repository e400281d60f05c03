"""The ST design tip DT0103 (A. Vitali, 2018): accelerometer-assisted calibration in a plane.

Installation error and hard iron from one turn, in closed steps: the turn's axis from the
accelerometer, the normal of the field's plane, the centre of its circle, and the installation
that takes the one normal to the other. The tip's own traps are left out: its normals forced
upwards one by one, its Newton search, its hard switch between level and tilted axes, and its
silence about samples that cannot carry an answer.
"""

from magcal_ros.core.methods.design_tip.fit import fit
from magcal_ros.core.methods.design_tip.options import AxisSource, Options

__all__ = ["AxisSource", "Options", "fit"]
