"""Picture of a mechanism: links, torques as arcs about the joints, and lines of text."""

import os
from collections.abc import Mapping, Sequence
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

        Text is at the bottom; the links are scaled to the space above it.

        Args:
            measurement: time [s], position [rad] and torque [N m], each () or (n,), by name.
            max_torque: torque of an arc of three quarters of a turn [N m].
            lines: lines of text; at most `MAX_LINES` are shown.
            lengths: relative lengths of the links (n,).
            angles: angles of the links (n,) from hanging down at joint position zero [rad].
        """
        if self.mode is None:
            gym.logger.warn("render was called without a render_mode: pass render_mode='rgb_array' to gym.make")
            return None
        if self.mode == "human":
            if self._next_frame - 1.0 / FRAMES < measurement["time"] < self._next_frame:
                return None
            self._next_frame = measurement["time"] + 1.0 / FRAMES
        pygame = self._open()
        surface = self._surface
        surface.fill(PAPER)
        positions, torques = np.atleast_1d(measurement["position"]), np.atleast_1d(measurement["torque"])
        q_text, torque_text = " ".join(f"{q:+.3f}" for q in positions), " ".join(f"{u:+.2f}" for u in torques)
        status = f"t {measurement['time']:.2f} s   q {q_text} rad   torque {torque_text} N m"
        shown_lines = [status, *lines][:MAX_LINES]
        top = HEIGHT - LINE * len(shown_lines) - LINE // 2  # of the text
        for k, line in enumerate(shown_lines):
            surface.blit(self._font.render(line, True, INK), (12, top + LINE * k))
        pivot, reach = np.array([WIDTH // 2, top // 2]), min(REACH, top // 2 - BOB)
        absolute_angles, shares = np.cumsum(positions) + angles, np.divide(lengths, np.sum(lengths))
        for q, torque, share in zip(absolute_angles, torques, shares, strict=True):
            bob = pivot + reach * share * np.array([np.sin(q), np.cos(q)])
            angle = 1.5 * np.pi * torque / max_torque
            if abs(angle) > 0.02:
                turn = np.linspace(0.0, angle, 40)
                arc = pivot + 0.36 * reach * share * np.column_stack([np.sin(turn), np.cos(turn)])
                pygame.draw.lines(surface, TORQUE, False, arc.tolist(), 5)
            pygame.draw.line(surface, LINK, pivot.tolist(), bob.tolist(), 12)
            pygame.draw.circle(surface, LINK, bob.tolist(), BOB)
            pygame.draw.circle(surface, INK, pivot.tolist(), 7)
            pivot = bob
        if self.mode == "rgb_array":
            return np.transpose(pygame.surfarray.array3d(surface), (1, 0, 2))
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
