"""The World Magnetic Model's coefficients as NOAA and BGS publish them: public domain.

`WMM2015.COF` is the second edition (WMM2015v2), which replaced the first in 2019.
"""
