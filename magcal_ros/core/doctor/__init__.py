"""Faults of the sensors: of each stream by itself, and of each sensor against the others.

`sensor_report.examine` asks the questions in this order; each answer is a `finding.Finding`:

- Is each stream complete, in its unit and range, alive, and stamped evenly, and do the stamps of
  both come from one clock? (`health`; `prepared` cleans the log for the other questions.)
- Which unit has the gyro, which axes have gyro and magnetometer, and where does up point?
  (`motion` compares the sensors. `alignment` fits field and gravity to the gyro for many axes at
  once, `axes_hypotheses` compares the fits, and `axes_diagnosis` names the sensor that is wrong.)
- Which bias and scale has the gyro, how late are field and accelerometer, and do motors add a
  field? (`turn_errors`, by the smoother's fit of the turn in `turn_fit`.)
- Do strength and inclination of the field agree with the reference? (`field_by_movement`.)
- Is this a known fault of a driver? (`quirks`.)

`sensor_report.wrong_axes` and `wrong_reading` refuse a turn by the same answers. `guide` leads a
user through the movement that determines all of them.
"""

from magcal_ros.core.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    """
    axes_diagnosis: mount_of parameter_line
    axes_hypotheses: compare_axes gravity_misfit
    guide: Guide GuideStep
    health: alive_finding field_findings gravity_size_finding noise_findings repeats_finding
        stamps_finding stuck_axes
    prepared: prepare segment_of_log
    quirks: AK09916_IN_ICM20948 AK8963_IN_MPU9250 FIELD_POINTS_UP QUIRKS WRAP
    sensor_report: SensorReport examine examine_window refusal_by_sensors with_explanation
        wrong_axes
    turn_fit: fit_turn force_latency
    """,
)
