"""Numbers that set the resolution of data and fits; limits of decisions are fields of `Criterion`."""

from dataclasses import dataclass


@dataclass(frozen=True)
class DataSettings:
    """Numbers of split, contacts, regions, edges and variants."""

    motion: float = 0.5  # least share of the motion that is fitted, if the end of each recording is held out
    repeated: int = 2  # least number of contacts with a stop: a single one may be an accident
    shortest: float = 0.25  # least factor on the lengths of windows, if longer windows are too few
    regions: int = 6  # largest number of regions of a residual
    instants: tuple[float, float] = (1e-3, 10.0)  # least and largest tried displacement of an instant [s]
    edges: tuple[float, float] = (1e-5, 0.7)  # the same of another edge [step units]
    displacements: int = 40  # number of displacements of an edge to each side
    within: tuple[float, ...] = (0.6827, 0.9545, 0.9973)  # probability within 1, 2, 3 standard errors
    crossing: float = 5.0  # least step of the motion across an end [standard deviations of the encoder's noise]
    starts: int = 2  # best variants per form from which a search over nonlinear parameters starts
    coarse: int = 24  # largest number of variants of continuous parameters, where each fit takes seconds


DATA = DataSettings()
