"""Numbers of online estimation and diagnosis, and limits of decisions on them."""

from dataclasses import dataclass


@dataclass(frozen=True)
class StreamSettings:
    """Samples that give the noise of sensors, and samples of a linked mechanism that are converted together."""

    noise: int = 256  # number of samples that give the noise, in motion of one joint if the encoder is unknown
    moving_share: float = 0.25  # least number of samples in motion of another joint, relative to `noise`
    longest: int = 2048  # largest number of waiting samples, including rest
    arm_chunk: float = 0.05  # [s], samples with links; the cost is nearly independent of their number
    arm_transient: float = 0.1  # [s] before them for filters: exp(-20) of the transient remains at 200 rad/s


@dataclass(frozen=True)
class BinSettings:
    """Averages of a few samples."""

    length: float = 0.01  # [s], long against encoder noise, short against effects
    chunk: int = 20  # bins in a chunk, which gives one gain; errors of successive chunks are nearly independent
    update: int = 10  # bins that are evaluated together
    history: int = 20  # bins of torque before a bin, for late torques
    slice: float = 0.002  # [s], longest slice of the torque
    torque_step: float = 1e-3  # [N m], for derivatives by the torque

    @property
    def chunk_time(self) -> float:
        """Duration of a chunk of bins in motion [s]."""
        return self.chunk * self.length


@dataclass(frozen=True)
class WorkSettings:
    """Parts of computations, see `estimators.online.work`; a part takes about as long as the prediction of a bin."""

    per_bin: float = 10.0  # parts per bin of motion; predictions and ranking need about three
    rows: int = 2000  # rows of variants in a part of a fit; a single variant may have more
    bins: int = 100  # bins that are stacked in a part
    variants: int = 4  # variants of a grid that are checked in a part
    splits: int = 4  # fits of trial changes in a part


@dataclass(frozen=True)
class ModelSettings:
    """Fits and mixtures of competing models; chosen on simulated plants by `benchmarks.online_diagnosis`."""

    calibration: float = 1.0  # [s] of motion in the first fit of all models
    refinements: tuple[int, ...] = (2, 4, 8, 16)  # [s] of motion before a refinement of the grids
    memories: tuple[float, ...] = (1.0, 4.0)  # [s] of motion, of the models with forgetting
    scale_memory: int = 3000  # bins, memory of the error scale
    error_time: float = 10.0  # [s] of motion, averaging time of the reported error
    blocks: int = 60  # number of latest blocks for the probabilities
    least_weight: float = -12.0  # log weight relative to the best variant
    least_memory_weight: float = -4.0  # the same of models with forgetting
    tangents: int = 4  # iterations of a fit with columns that depend on the torque
    late_step: float = 1e-3  # relative step of a delay or lag, for derivatives
    late_variants: int = 8  # largest number of variants of a late torque
    variants: int = 12  # largest number of variants with continuous nonlinear parameters
    splits: int = 24  # trial times of a change of parameters

    @property
    def fit_time(self) -> float:
        """Longest time of motion in a fit [s]: up to the last refinement."""
        return self.refinements[-1]


@dataclass(frozen=True)
class EvidenceSettings:
    """Bets of an e-process, and the usual gain of forgetting."""

    stakes: tuple[float, ...] = (0.05, 0.2, 0.8)  # shares of the wealth
    most: float = 10.0  # [c], upper limit of the gain of a single chunk
    least_bound: float = 1.0  # [nat], least value of c
    margin: float = 1.5  # ratio of c and the largest loss so far
    memory: int = 300  # chunks, memory of the usual gain
    first: int = 8  # chunks before a gain counts
    outlier: float = 2.0  # standard deviations above the mean, to which larger gains are clipped


@dataclass(frozen=True)
class CovarianceSettings:
    """Clusters of errors; chosen by the coverage of intervals on simulated plants."""

    most: int = 64  # clusters; at this number, neighbours are merged
    extra: int = 10  # clusters beyond the number of parameters that a covariance needs
    memory_share: float = 0.1  # longest duration relative to the memory of forgetting
    guess: float = 60.0  # variance relative to white errors before the clusters suffice


@dataclass(frozen=True)
class JointStateSettings:
    """Start and noise of the unscented Kalman filter; chosen on simulated plants by `benchmarks.joint_state`."""

    start_std: float = 0.1  # relative standard error of the inertia at the start; added to that of each parameter
    motion_time: float = 1.0  # [s] of motion in the regression before the filter starts
    velocity_std: float = 5.0  # [rad/s], standard deviation of the initial velocity
    torque_std: float = 0.1  # [N m], initial standard deviation of the torque about the measured one
    learning_time: float = 0.5  # [s], time constant of the log of the torque noise
    outlier: float = 3.0  # standard deviations, to which innovations are clipped in the estimate of the noise
    least_noise: float = 1e-7  # [rad], least position noise: integration errors are as large


@dataclass(frozen=True)
class OnlineLimits:
    """Limits of decisions; chosen on simulated plants by `benchmarks.online_diagnosis`."""

    gain: float = 0.01  # [nat] per bin, least gain that counts: errors smaller by 1 %
    change_evidence: float = 3.0  # [nat] of forgetting, above which an alarm may be a change
    change_z_score: float = 4.0  # least change of a parameter in standard errors, for many chunks
    share_after_change: float = 0.5  # share of the threshold that an effect must reach after a change
    least_explained: float = 1 / 3  # share of the error's square above its floor, for an effect that leaves an error
    blocks: int = 5  # before parameters are compared with given ones, an error is unexplained, or blocks are compared
    report_time: float = 2.0  # [s] of motion between a change and its report


@dataclass(frozen=True)
class OnlineSettings:
    """All numbers of online estimation and diagnosis."""

    stream: StreamSettings = StreamSettings()
    bins: BinSettings = BinSettings()
    work: WorkSettings = WorkSettings()
    models: ModelSettings = ModelSettings()
    evidence: EvidenceSettings = EvidenceSettings()
    covariance: CovarianceSettings = CovarianceSettings()
    joint_state: JointStateSettings = JointStateSettings()
    limits: OnlineLimits = OnlineLimits()


ONLINE = OnlineSettings()
