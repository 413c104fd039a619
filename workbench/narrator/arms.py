"""Results on arms in words."""

from estimators.arms.standard import Nearest


def describe_nearest_body(found: Nearest) -> str:
    """State whether a body has the identified parameters."""
    if found.exists:
        return f"some body has these parameters, within {max(found.distance, 0.1):.1f} standard errors"
    return f"no body has these parameters: the nearest is {found.distance:.1f} standard errors off, in {found.farthest}"
