"""Several turns at different tilts, joined into one estimate of the full correction."""

from magcal_ros.core.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    """
    result: KeptTurns MultiTurnReport TurnAccuracy TurnAdvice TurnResult names_of
    """,
)
