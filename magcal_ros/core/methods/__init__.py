"""The methods that estimate a correction from a window, all with one signature.

A method is a function `fit(window, knowledge) -> Estimate` that raises `Refusal` if the samples do
not determine a calibration.
"""
