import numpy as np

from benchmarks.independent_plant import Experiment, Plant
from estimators.findings import Kind
from tests.cases import diagnosed, recorded

TIME = np.arange(6000) / 500.0
SPRING = Plant(0.09, 2.0, 0.35, 0.3, {"spring": {"spring_k": 0.5, "spring_q0": 0.0}})


def test_gravity_is_conditional_where_an_effect_of_the_angle_is_seen_over_part_of_a_turn():
    within = 2.2 * np.sin(4 * TIME) + 0.9 * np.sin(9.3 * TIME + 1)
    around = 3.4 * np.sin(1.1 * TIME) + 1.5 * np.sin(4.1 * TIME)
    found = {}
    for command in (within, around):
        experiment = Experiment(seed=3, seconds=12.0, rate=500.0)
        (run,) = recorded(SPRING, experiment, commands=[command])
        found[np.ptp(run.position) > 2 * np.pi] = diagnosed([run], only=["spring", "cogging", "stribeck"])
    assert all(one.selected == ("spring",) for one in found.values())
    caveats = {
        is_whole: [own for own in one.findings if own.kind is Kind.PART_OF_TURN] for is_whole, one in found.items()
    }
    assert not caveats[True]
    (caveat,) = caveats[False]
    assert caveat.effects == ("spring",) and 0.5 < caveat.numbers["angle"].value < 2 * np.pi
