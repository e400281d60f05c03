"""Results that depend on arguments only are computed once."""

import functools
import pickle


def remembered(function):
    """Give the result of an earlier call with equal arguments."""
    found = {}

    @functools.wraps(function)
    def recall(*arguments, **options):
        asked = pickle.dumps((arguments, options))
        if asked not in found:
            found[asked] = function(*arguments, **options)
        return found[asked]

    return recall
