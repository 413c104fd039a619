"""Planar arm of three servos by an integrator of its own: point masses, set-valued friction, gravity of all links.

M(q) q'' + h(q, q') + g(q) = kp (goal - q) - kd q' - friction,  measured angles are off by `ZERO`
"""

import numpy as np
from numba import njit

JOINTS = ("lift", "elbow", "wrist")
LENGTHS, MASSES = np.array([0.12, 0.12, 0.08]), np.array([0.12, 0.10, 0.08])  # [m], [kg] at the end of each link
ZERO = np.array([0.1, -0.1, 0.1])  # [rad], measured minus true angle
KP, ROTOR, VISCOUS, DRY = 8.0, 0.012, 0.35, 0.08  # of each servo: [N m/rad], [kg m^2], [N m s/rad], [N m]
COUNT = 2 * np.pi / 4096  # [rad], of the encoder
GRAVITY = 9.81

URDF = """<robot name="three"><link name="base"/>{}</robot>""".format(
    "".join(
        f'<link name="{at}_link"><inertial><origin xyz="{length} 0 0"/><mass value="{mass}"/>'
        '<inertia ixx="1e-5" ixy="0" ixz="0" iyy="1e-5" iyz="0" izz="1e-5"/></inertial></link>'
        f'<joint name="{at}" type="revolute"><parent link="{parent}"/><child link="{at}_link"/>'
        f'<origin xyz="{offset} 0 0"/><axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="9" velocity="9"/></joint>'
        for at, parent, offset, length, mass in zip(
            JOINTS, ("base", "lift_link", "elbow_link"), (0.0, *LENGTHS[:2]), LENGTHS, MASSES, strict=True
        )
    )
)


def make_goals(rng, seconds, rate=50.0):
    """Return time (N,) and goals (N, 3): sums of slow waves, then steps to random places with rests."""
    time = np.arange(int(seconds * rate)) / rate
    waves = sum(
        rng.uniform(0.1, 0.35, 3) * np.sin(2 * np.pi * rng.uniform(0.1, 0.7, 3) * time[:, None] + rng.uniform(0, 6, 3))
        for _ in range(2)
    )
    places = np.repeat(rng.uniform(-0.5, 0.5, (int(seconds / 1.5) + 1, 3)), int(1.5 * rate), axis=0)[: len(time)]
    goals = np.where(time[:, None] < seconds / 2, waves, waves[len(time) // 2] + 0.6 * places)
    return time, goals + np.array([0.3, -0.4, 0.2])


def simulate(rng, seconds, effect="", at="lift"):
    """Return time, goals and measured angles of a run, with one hidden effect at a joint."""
    time, goals = make_goals(rng, seconds)
    positions = np.empty_like(goals)
    integrate(goals, positions, effect, JOINTS.index(at), 5e-4)
    return time, goals, COUNT * np.round(positions / COUNT)


@njit(cache=True)
def integrate(goals, positions, effect, at, h):
    """Fill the positions (N, 3) at each goal (N, 3), which is held for 20 ms; steps last h [s]."""
    q, v = goals[0] - ZERO, np.zeros(3)
    forward, down, pull = np.empty(3), np.empty(3), np.empty((2, 3))
    arms = np.empty((2, 3, 3))  # of each mass about each joint, forward and down
    for n in range(len(goals)):
        positions[n] = q + ZERO
        for _ in range(round(0.02 / h)):
            angle = rate = 0.0
            for j in range(3):
                angle, rate = angle + q[j], rate + v[j]
                forward[j], down[j] = LENGTHS[j] * np.cos(angle), LENGTHS[j] * np.sin(angle)
                pull[0, j], pull[1, j] = -forward[j] * rate**2, -down[j] * rate**2  # centripetal, of one link
            arms[:] = 0.0
            inertia, net, dry = np.eye(3) * ROTOR, -VISCOUS * v, np.full(3, DRY)
            for j in range(3):  # masses
                for i in range(j + 1):  # joints before them
                    arms[0, i, j], arms[1, i, j] = forward[i : j + 1].sum(), down[i : j + 1].sum()
                for i in range(j + 1):
                    net[i] += MASSES[j] * GRAVITY * arms[0, i, j]  # rotation about y points down
                    for m in range(j + 1):
                        bend = arms[0, i, j] * pull[1, m] - arms[1, i, j] * pull[0, m]
                        net[i] -= MASSES[j] * bend
                        dot = arms[0, i, j] * arms[0, m, j] + arms[1, i, j] * arms[1, m, j]
                        inertia[i, m] += MASSES[j] * dot
            torque = KP * (goals[n] - q - ZERO)
            net += torque
            if effect == "load_dependent_friction":
                dry[at] += 0.25 * abs(torque[at])
            elif effect == "stribeck":
                dry[at] += 0.12 * np.exp(-((v[at] / 0.15) ** 2))
            elif effect == "quadratic_drag":
                net[at] -= 0.25 * v[at] * abs(v[at])
            inverse, impulse = np.linalg.inv(inertia), np.zeros(3)
            free = v + h * inverse @ net
            for _ in range(20):  # projected Gauss-Seidel on the impulses of set-valued friction
                for i in range(3):
                    now = free[i] + (inverse[i] * impulse).sum()
                    impulse[i] = min(max(impulse[i] - now / inverse[i, i], -h * dry[i]), h * dry[i])
            v = free + inverse @ impulse
            q = q + h * v


def write_arm(folder, rng, effect="", at="lift", runs=4, seconds=20.0):
    """Write robot, logs and study; return their paths. The last run is held out."""
    (folder / "arm.urdf").write_text(URDF)
    text = f'[drive]\noutput = "torque"\nkp = {KP}\ngoal = "held"\nreads = "exact"\nencoder = "output"\n'
    for k in range(runs):
        time, goals, angles = simulate(rng, seconds, effect, at)
        names = ["time", *(f"goal_{joint}" for joint in JOINTS), *(f"position_{joint}" for joint in JOINTS)]
        log = np.column_stack([time, goals, angles])
        np.savetxt(folder / f"run{k}.csv", log, delimiter=",", header=",".join(names), comments="", fmt="%.7g")
        text += f'[[recording]]\nfile = "run{k}.csv"\nrole = "{"holdout" if k == runs - 1 else "fit"}"\n'
    (folder / "arm.toml").write_text(text)
    return folder / "arm.urdf", folder / "arm.toml"
