"""Simulated drives: streets, wheels and receivers with faults."""

from simulated.drive import (
    AnySample,
    Drive,
    Fence,
    Iron,
    StreetField,
    Streets,
    Vehicle,
    random_vehicle,
    simulated_drive,
)
from simulated.legs import (
    Leg,
    circles,
    city,
    joined,
    motorway,
    one_street,
    parking,
    reversing,
    seconds_of,
    standing,
)
from simulated.reckoning import Receiver, Wheels
from simulated.travel import Body, Travel, exponential_noise, travel

__all__ = [
    "AnySample", "Body", "Drive", "Fence", "Iron", "Leg", "Receiver", "StreetField", "Streets",
    "Travel", "Vehicle", "Wheels", "circles", "city", "exponential_noise", "joined", "motorway",
    "one_street", "parking", "random_vehicle", "reversing", "seconds_of", "simulated_drive",
    "standing", "travel",
]  # fmt: skip
