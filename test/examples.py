"""The number of random cases of a property: ten times as many with `make nightly`."""

from hypothesis import settings


def examples(count, **options):
    """Return the settings of a property that tries so many cases in `make test`."""
    times = settings.default.max_examples / settings.get_profile("project").max_examples
    return settings(max_examples=round(count * times), **options)
