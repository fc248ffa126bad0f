"""Copies of results with one change, which checks of results must notice."""

import dataclasses


def changed(result, path, change):
    """A copy with another value of a field or a derived quantity, also of a part (`part.name`)."""
    name, _, rest = path.partition(".")
    value = getattr(result, name)
    value = changed(value, rest, change) if rest else change(value)
    if name in {field.name for field in dataclasses.fields(result)}:
        return dataclasses.replace(result, **{name: value})
    copy = dataclasses.replace(result)
    # Derived quantities are kept by the result once they are computed.
    copy.__dict__[name] = value
    return copy
