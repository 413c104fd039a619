"""Picture of a mechanism: links, torques as arcs about the joints, and lines of text."""

import os
from collections import deque
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from pendulum_env.lookup import find

MODES = ("human", "rgb_array")
WIDTH, HEIGHT = 600, 480  # [pixels]
REACH, BOB = 173, 18  # [pixels], length of all links together, and radius of the discs at their ends
LINE, MAX_LINES = 20, 15  # [pixels] between lines of text, and largest number of lines
FRAMES = 50  # pictures per second of simulated time, in a window
PAPER, INK, LINK, TORQUE = (250, 249, 246), (40, 44, 52), (52, 101, 164), (204, 92, 40)
FAINT = (214, 211, 203)
SMOOTH = 2  # pixels of the canvas for one of the picture, which averages them
SCALE = 0.85 * np.pi  # arc of the largest torque [rad]
HEAD = 15  # length of an arrow head [pixels]
TRAIL = 0.6  # length of the trail [s]

Color = tuple[int, int, int]


class Renderer:
    """Renderer by pygame, which is imported at the first picture."""

    def __init__(self, mode: str | None) -> None:
        """Set the mode, None for no pictures; a window opens with the first picture.

        Raises:
            ValueError: if the mode is unknown.
        """
        if mode is not None:
            find("render_mode", mode, dict.fromkeys(MODES))
        self.mode = mode
        self._reset()

    def _reset(self) -> None:
        self._surface: Any = None
        self._font: Any = None
        self._clock: Any = None
        self._next_frame = -np.inf
        self._trail = deque[tuple[float, NDArray[Any]]]()  # time [s] and place of the tip

    def __reduce__(self) -> Any:
        return Renderer, (self.mode,)  # without the window, which cannot be pickled

    def draw(
        self,
        measurement: Mapping[str, Any],
        max_torque: float,
        lines: Sequence[str],
        lengths: Sequence[float] = (1.0,),
        angles: Sequence[float] = (0.0,),
    ) -> NDArray[np.uint8] | None:
        """Return a picture (H, W, 3) in mode rgb_array, or show `FRAMES` pictures per second in mode human.

        Text is at the bottom; the links are scaled to the space above it. The tip leaves a trail, and each torque is an
        arrow along a scale that ends at the largest torque of either sign. Stops of the plant are drawn.

        Args:
            measurement: time [s], position [rad] and torque [N m], each () or (n,), by name; perhaps `plant`.
            max_torque: torque at the end of the scale [N m].
            lines: lines of text; at most `MAX_LINES` are shown.
            lengths: relative lengths of the links (n,).
            angles: angles of the links (n,) from hanging down at joint position zero [rad].
        """
        if self.mode is None:
            gym.logger.warn("render was called without a render_mode: pass render_mode='rgb_array' to gym.make")
            return None
        time = float(measurement["time"])
        if self.mode == "human":
            if self._next_frame - 1.0 / FRAMES < time < self._next_frame:
                return None
            self._next_frame = time + 1.0 / FRAMES
        pygame = self._open()
        positions, torques = np.atleast_1d(measurement["position"]), np.atleast_1d(measurement["torque"])
        q_text, torque_text = " ".join(f"{q:+.3f}" for q in positions), " ".join(f"{u:+.2f}" for u in torques)
        status = f"t {time:.2f} s   q {q_text} rad   torque {torque_text} of {max_torque:.3g} N m"
        shown_lines = [status, *lines][:MAX_LINES]
        top = HEIGHT - LINE * len(shown_lines) - LINE // 2  # of the text
        absolute_angles, shares = np.cumsum(positions) + angles, np.divide(lengths, np.sum(lengths))
        reach = SMOOTH * min(REACH, top // 2 - BOB)
        steps = reach * shares[:, None] * point(absolute_angles)
        joints = SMOOTH * np.array([WIDTH // 2, top // 2]) + np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])

        canvas = pygame.Surface((SMOOTH * WIDTH, SMOOTH * HEIGHT))
        canvas.fill(PAPER)
        if self._trail and not 0 <= time - self._trail[-1][0] < TRAIL:
            self._trail.clear()
        self._trail.append((time, joints[-1]))
        while time - self._trail[0][0] > TRAIL:
            self._trail.popleft()
        for (_, start), (then, end) in pairwise(self._trail):
            color = mix(LINK, PAPER, 0.85 * (time - then) / TRAIL)
            pygame.draw.line(canvas, color, start.tolist(), end.tolist(), 3 * SMOOTH)
        plant = measurement.get("plant", {})
        for name in ("hard_stop.lower", "hard_stop.upper"):
            if name in plant:
                ray = point(np.array([plant[name] + angles[0]]))[0]
                ends = [(joints[0] + radius * reach * shares[0] * ray).tolist() for radius in (0.9, 1.2)]
                pygame.draw.line(canvas, INK, *ends, 5 * SMOOTH)
        for pivot, bob, torque, share in zip(joints, joints[1:], torques, shares, strict=False):
            radius = 0.36 * reach * share
            _draw_arc(canvas, pivot, radius, (-SCALE, SCALE), FAINT, 2 * SMOOTH)
            for tick in (-SCALE, 0.0, SCALE):
                ray = point(np.array([tick]))[0]
                ends = [(pivot + factor * radius * ray).tolist() for factor in (0.92, 1.08)]
                pygame.draw.line(canvas, FAINT, *ends, 2 * SMOOTH)
            if abs(angle := SCALE * torque / max_torque) > 0.02:
                _draw_arc(canvas, pivot, radius, (0.0, angle), TORQUE, 5 * SMOOTH)
                tip = pivot + radius * point(np.array([angle]))[0]
                along = np.sign(angle) * point(np.array([angle + np.pi / 2]))[0]
                out, size = np.array([-along[1], along[0]]), HEAD * SMOOTH * min(1.0, abs(angle) / 0.3)
                head = [tip + size * along, tip + 0.6 * size * out, tip - 0.6 * size * out]
                pygame.draw.polygon(canvas, TORQUE, [corner.tolist() for corner in head])
            pygame.draw.line(canvas, LINK, pivot.tolist(), bob.tolist(), 12 * SMOOTH)
            pygame.draw.circle(canvas, LINK, bob.tolist(), BOB * SMOOTH)
            pygame.draw.circle(canvas, INK, pivot.tolist(), 7 * SMOOTH)
        pygame.transform.smoothscale(canvas, (WIDTH, HEIGHT), self._surface)
        for k, line in enumerate(shown_lines):
            self._surface.blit(self._font.render(line, True, INK), (12, top + LINE * k))
        if self.mode == "rgb_array":
            return np.transpose(pygame.surfarray.array3d(self._surface), (1, 0, 2))
        pygame.event.pump()
        pygame.display.flip()
        self._clock.tick(FRAMES)
        return None

    def _open(self) -> Any:
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        import pygame

        if self._surface is None:
            pygame.font.init()
            if self.mode == "human":
                pygame.display.init()
                self._surface = pygame.display.set_mode((WIDTH, HEIGHT))
                pygame.display.set_caption("direct-drive pendulum")
                self._clock = pygame.time.Clock()
            else:
                self._surface = pygame.Surface((WIDTH, HEIGHT))
            self._font = pygame.font.SysFont("dejavusansmono,monospace", 14)
        return pygame

    def close(self) -> None:
        """Close the window, if it is open."""
        if self._surface is not None and self.mode == "human":
            self._open().display.quit()
        self._reset()


def point(angles: NDArray[Any]) -> NDArray[Any]:
    """Return unit vectors (n, 2) in pixels at angles (n,) from hanging down [rad]."""
    return np.column_stack([np.sin(angles), np.cos(angles)])


def mix(color: Color, other: Color, share: float) -> Color:
    """Mix a share of another colour into a colour."""
    red, green, blue = (round((1 - share) * a + share * b) for a, b in zip(color, other, strict=True))
    return red, green, blue


def _draw_arc(
    canvas: Any, center: NDArray[Any], radius: float, ends: tuple[float, float], color: Color, width: int
) -> None:
    """Draw an arc between two angles [rad] about a centre."""
    import pygame

    rays = point(np.linspace(*ends, 90))
    corners = np.vstack([center + (radius + width / 2) * rays, center + (radius - width / 2) * rays[::-1]])
    pygame.draw.polygon(canvas, color, corners.tolist())
