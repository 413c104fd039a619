"""What an engine is to push with: the same compiled and by NumPy, for every effect; and laws that are no formulas."""

import gymnasium as gym
import numpy as np
import pytest

from pendulum_env.backends.half_steps import Compiled, Interpreted, half_steps
from pendulum_env.physics import Samples, effects
from pendulum_env.physics.simulation import Balance
from pendulum_env.plant import hide, paper_plant
from pendulum_env.registration import PENDULUM
from tests.terms import Clipped, Table

H = 2e-3  # [s]


@pytest.mark.parametrize("effect", effects())
def test_programs_push_as_numpy_does(effect):
    """Along a motion that starts, turns round, and rests."""
    plant = hide(paper_plant(), {"hard_stop": "hard_stop:upper=0.3"}.get(effect, effect))
    balance = Balance(plant.terms, plant.theta)
    both = Compiled(balance, H), Interpreted(balance)
    x = Samples(*np.zeros(4))
    for halves in both:
        halves.place(Samples(x.time, x.position, x.velocity, x.torque, balance.start(x)))
    time, position, velocity, told = 0.0, 0.1, 0.0, []
    rng = np.random.default_rng(0)
    for k in range(600):
        torque = 3.0 * np.sin(0.02 * k) if k < 500 else 0.0
        state = time, position, velocity, torque, H
        program, numbers = (halves.push(*state) for halves in both)
        np.testing.assert_allclose(program, numbers, rtol=1e-9, atol=1e-9)
        told.append(program.middle)
        middle = position + 0.5 * H * velocity
        reached = velocity + rng.normal(0.0, 0.02) - 0.05 * velocity if k < 500 else 0.0
        for halves in both:
            halves.complete(time + 0.5 * H, middle, 0.5 * (program.middle + reached), torque, H)
        time, position, velocity = time + H, position + H * velocity, reached
    assert np.std(told) > 0.01


def test_a_plant_whose_law_is_no_formula_moves_all_the_same():
    model = paper_plant()
    tables, formulas = (model.add(kind(), [0.7]) for kind in (Table, Clipped))
    assert isinstance(half_steps(Balance(tables.terms, tables.theta), H), Interpreted)
    assert isinstance(half_steps(Balance(formulas.terms, formulas.theta), H), Compiled)
    paths = []
    for plant in (tables, formulas):
        env = gym.make(PENDULUM, model=plant, counts=0)
        env.reset(seed=0)
        pushes = 4.0 * np.sin(0.004 * np.arange(1500, dtype=np.float32))[:, None]
        paths.append([env.step(push)[-1]["position"] for push in pushes])
    assert np.ptp(paths[0]) > 1.0
    np.testing.assert_allclose(*paths, rtol=0, atol=1e-9)
