"""The Earth's field at a place."""

from magcal_ros.core.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    """
    reference: Fix Fixes LocalField LocalPlane made_elsewhere place_of resolve
    wmm: EARTH_RADIUS NoModel decimal_year model_field year_of
    """,
)
