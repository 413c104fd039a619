"""Numbers that decide on windows: lengths, errors, blocks, contacts and the search for variants of effects."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CutSettings:
    """Smoothing of a recording and distance of its windows from stick."""

    smoothing: float = 0.75  # longest half width of the smoothing of position [half windows]: shape of window kept
    swing_smoothing: float = 0.3  # the same for long windows of a free swing, which include reversals
    shift: int = 3  # smoothing may shift a zero of the velocity by one over this [half widths of the smoothing]
    moving: float = 5.0  # least speed in motion [standard deviations of its noise]: the sign is known
    mostly: float = 0.5  # share of motion above which a window near stick turns, and below which it rests
    dense: int = 4  # windows near a reversal per half window: a contact is short
    lead_in: float = 0.1  # longest lead-in, share of a segment: most of a short segment stays
    jump: float = 4.0  # least jump of sampled torque [standard deviations of its changes by noise]
    neighbours: int = 5  # changes whose median is compared with a jump


@dataclass(frozen=True)
class WidthSettings:
    """Choice of the length of windows, by their number and their noise."""

    enough: int = 100  # windows clear of stick that suffice for a window length
    clear: float = 0.3  # share of the recording in these windows that also suffices, half a window each
    calibrating: int = 40  # least number of windows whose fit gives inertia and noise: three per smooth law
    quiet: float = 0.7  # largest encoder noise of a window [standard deviations of its torque noise]: adds 22 %
    negligible: float = 0.01  # encoder noise that hides no effect of practical use, share of the torque
    negligible_swing: float = 0.002  # the same for a free swing, where friction is a small share of the torque
    decay: float = 2.5  # encoder noise falls with the length to this power: two derivatives, and the mean of samples
    longest_swing: float = 0.5  # longest window of a free swing [periods]: the torque changes sign in longer ones
    shares: tuple[float, ...] = (0.05, 0.2)  # Stribeck speeds of the smooth laws, shares of the fast speed
    orders: tuple[float, ...] = (2.0, 3.0)  # orders of cogging of the smooth laws; gravity has order 1


@dataclass(frozen=True)
class VariantSettings:
    """Extent of the search for the best variant of an effect."""

    exact: int = 3  # number of the best torque-dependent variants that are fitted exactly
    longest: float = 100.0  # largest time constant [recorded times]
    reach: float = 0.03  # half width of the scan for an instant, share of the recorded time
    gain: float = 2e-6  # least relative decrease of the squared error of torque-dependent terms in an iteration
    follows: int = 3  # iterations that set a nonlinear parameter to the linear parameter that it follows
    perturbation: float = 1e-6  # of the torque for derivatives, share of the largest torque
    perturbations: tuple[float, ...] = (0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 1.5, 2.0)  # for nonlinear laws
    cached: int = 4  # number of sets of terms with cached equations: memory


@dataclass(frozen=True)
class Resolution:
    """Numbers of windowed equations.

    Attributes:
        cut, width, variants: settings of the steps.
    """

    precision: float = 5e-4  # error of smoothing and integration, share of the standard deviation of torque
    fewest: int = 10  # least number of windows, to estimate errors
    fewest_of_joint: int = 20  # the same of each of several joints, whose links have more parameters
    light: float = 0.05  # inertia that scales encoder noise for the weights of recordings, before a fit [kg m^2]
    least_noise: float = 0.003  # least noise in these weights, share of the torque: no recording outweighs all others
    pieces: int = 30  # least number of clusters of all recordings, to estimate errors
    clusters: int = 4  # least number of clusters per parameter of links
    shortest: int = 4  # least length of a cluster with links, above the correlation time of errors [half windows]
    longest: float = 0.5  # longest cluster [s]: above the correlation time of errors
    wrong_zero: float = 2.0  # residual of the base model from which the zero may be wrong [noise floors]
    tilted: float = 0.5  # residual with tilted gravity, share of that without, if the zero of the position is wrong
    significant: float = 5.0  # standard errors by which the residual of a contact exceeds friction
    contact: float = 1.0  # a lasting contact counts once in this time [s]
    places: int = 50  # samples of a recording over which a joint's inertia is averaged, about
    growth: float = 10.0  # growth of an error of the initial position in a segment from which its motion is unstable
    density: int = 4  # entries per sample of a matrix of averages, above which an operator slides the window
    cut: CutSettings = CutSettings()
    width: WidthSettings = WidthSettings()
    variants: VariantSettings = VariantSettings()


RESOLUTION = Resolution()
