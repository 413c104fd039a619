"""Online estimation and diagnosis, sample by sample.

    samples -> stream -> equations -> OnlineEstimator: parameters of all schemes
                 |
               Binner -> bins of motion -> Diagnoser: missing effects, changed parameters

A stream converts samples of B pendulums (`stream`), or with links in chunks (`arm_stream`), into equations. Both
take samples by `take(time, position, torque)`, and restart by `reset(which)`. `stream_recording` takes a recording.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
