"""Numbers of simulations and fits of servos in the loop; limits of decisions are in `Criterion.loop`."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class SimulationSettings:
    """Steps of simulations, and errors of positions that no model causes."""

    grain: float = 0.02  # [s] between compared positions, about
    steps: int = 11  # of the integrator in this time, during a search
    fine_steps: int = 20  # the same for the final fit
    link_factor: int = 2  # of the number of steps with a link: its contact is stiffer than the joint
    same_rate: float = 0.01  # relative difference of the rates of logs that are compared at their samples
    slack: float = 0.01  # share of a step that may be missing, by rounding
    farthest: float = 2.0  # [rad], largest error; a simulation that diverged has this error
    precision: float = 1e-4  # error of a simulation, share of the motion
    jitter: float = 0.03  # error of a clock [samples]
    correlated: float = 1.5  # [s], over which errors of a rollout are correlated


@dataclass(frozen=True)
class EncoderSettings:
    """Steps of an encoder in a log."""

    finest: float = 1e-6  # [rad], least step; smaller ones are rounding
    unseen: float = 1e-12  # [rad], step without visible counts: one compiled step simulates it and counts
    reaches: tuple[float, ...] = (3.0, 30.0, 300.0, np.inf)  # counts over which the step is fitted in sequence
    off_grid: float = 0.1  # largest deviation from the grid, in counts: decimals of the log


@dataclass(frozen=True)
class FitSettings:
    """Steps of fits, and gains at which they end."""

    iterations: int = 30  # largest number of iterations
    dampings: tuple[float, ...] = (1e-4, 1e-2, 0.3, 10.0, 300.0)  # of the steps in each iteration
    momenta: tuple[float, ...] = (1.0, 5.0)  # multiples of the last step, each tried with the least damped one
    differences: tuple[float, ...] = (3e-3, 1e-2)  # steps for derivatives, relative to the parameter, in sequence
    secants: tuple[float, ...] = (0.2, 0.06)  # the same over many local minima, to either side
    leap: float = 1.0  # largest step of a parameter, relative to its size
    polls: int = 5  # largest number of polls, which try steps of single parameters
    poll: tuple[float, ...] = (0.1, 0.4)  # lengths of these steps, relative to the parameter; they pass a kink
    enough: float = 0.3  # [nat], a fit ends at a smaller gain of an iteration,
    roughly: float = 0.05  # or at this share of its gain so far if models are only compared
    friction: tuple[float, ...] = (0.3, 1.0, 3.0)  # other starts of dry friction, relative to the parameter
    settled: float = 1e-7  # relative change of an error scale that has converged
    typical: float = 0.05  # share of the RMS torque at which a parameter matters
    hasty_share: float = 0.3  # the same for the starts of long recordings; the likeliest is fitted further
    long_count: int = 20000  # number of compared positions of long recordings
    hopeless: float = 15.0  # [nat], gain of the linear fit below which one iteration suffices


@dataclass(frozen=True)
class SearchSettings:
    """Pieces of long recordings in a search."""

    count: int = 12000  # samples in all; more are left to the final fits
    piece: float = 12.0  # [s], length of a piece
    steps: int = 6  # of the integrator in `SimulationSettings.grain`
    fine_steps: int = 8  # the same for the final fit of the whole recordings


@dataclass(frozen=True)
class LinkSettings:
    """Starts of the fit of a link, over whose parameters the likelihood has many local minima."""

    starts: int = 4  # largest number of starts, at the likeliest values of the profiled parameter
    finalists: int = 2  # number of the best fits from these starts that are fitted to convergence
    shares: tuple[float, ...] = (0.3, 0.6, 0.85)  # of the inertia that is behind the link
    stiffnesses: tuple[float, ...] = (1.0, 2.5)  # factors of its resonance; a fit of torque prefers a soft contact
    damping_ratios: tuple[float, ...] = (0.05, 0.2, 0.5)  # of the contact
    friction: tuple[float, ...] = (0.1, 0.02)  # shares of dry and viscous friction that are behind the link


@dataclass(frozen=True)
class ProfileSettings:
    """Values of the parameter of a profile likelihood."""

    ratio: float = 1.1  # of neighbouring values at first
    fall: float = 20.0  # [nat], largest fall of the likelihood from the best value to its neighbours
    beside: int = 2  # number of values of the parabola on either side of the best
    most: int = 12  # largest number of values
    leaps: tuple[float, ...] = (0.8, 0.9, 1.1, 1.25)  # factors of the `multimodal` parameter in other starts
    gain: float = 1.0  # [nat], least gain of a fit after a leap


@dataclass(frozen=True)
class LoopSettings:
    """All numbers of fits in the loop."""

    simulation: SimulationSettings = SimulationSettings()
    encoder: EncoderSettings = EncoderSettings()
    search: SearchSettings = SearchSettings()
    fit: FitSettings = FitSettings()
    link: LinkSettings = LinkSettings()
    profile: ProfileSettings = ProfileSettings()


LOOP = LoopSettings()
