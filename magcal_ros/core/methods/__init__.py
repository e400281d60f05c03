"""Every way from a window to a correction, all with one signature.

A method is a function `fit(window, knowledge) -> Estimate` that raises `Refusal` when the samples
cannot carry an answer.
"""
