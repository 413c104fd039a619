"""A picture of the pendulum: the arm, the torque as an arc about the pivot, and lines of text."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

MODES = ("human", "rgb_array")
WIDTH, HEIGHT = 600, 480  # [pixels]
FRAMES = 50.0  # per second of simulated time, in a window
PAPER, INK, ARM, TORQUE = (250, 249, 246), (40, 44, 52), (52, 101, 164), (204, 92, 40)


class Renderer:
    """Draws with pygame, which is imported when first needed."""

    def __init__(self, mode: str) -> None:
        """Nothing is opened before the first picture."""
        self.mode = mode
        self._forget()

    def _forget(self) -> None:
        self._surface: Any = None
        self._font: Any = None
        self._clock: Any = None
        self._due = -np.inf

    def __getstate__(self) -> dict[str, Any]:
        return {"mode": self.mode}  # a window cannot be pickled: it opens anew

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(state["mode"])  # type: ignore[misc]

    def draw(self, measurement: Mapping[str, Any], max_torque: float, lines: Sequence[str]) -> NDArray[np.uint8] | None:
        """Picture (H, W, 3) in mode rgb_array; in mode human the window shows it, 50 times a second.

        Args:
            measurement: time [s], position [rad] and torque [N m].
            max_torque: torque at which the arc goes three quarters round [N m].
            lines: of text to show.
        """
        if self.mode == "human":
            if self._due - 1.0 / FRAMES < measurement["time"] < self._due:
                return None
            self._due = measurement["time"] + 1.0 / FRAMES
        pygame = self._open()
        surface = self._surface
        surface.fill(PAPER)
        center, length = np.array([WIDTH // 2, HEIGHT // 2 - 20]), 0.36 * HEIGHT
        q, torque = measurement["position"], measurement["torque"]
        bob = center + length * np.array([np.sin(q), np.cos(q)])
        angle = 1.5 * np.pi * torque / max_torque
        if abs(angle) > 0.02:
            turn = np.linspace(0.0, angle, 40)
            arc = center + 0.13 * HEIGHT * np.column_stack([np.sin(turn), np.cos(turn)])
            pygame.draw.lines(surface, TORQUE, False, arc.tolist(), 5)
        pygame.draw.line(surface, ARM, center.tolist(), bob.tolist(), 12)
        pygame.draw.circle(surface, ARM, bob.tolist(), 18)
        pygame.draw.circle(surface, INK, center.tolist(), 7)
        told = [f"t {measurement['time']:.2f} s   q {q:+.3f} rad   torque {torque:+.2f} N m", *lines]
        for k, line in enumerate(told):
            surface.blit(self._font.render(line, True, INK), (12, HEIGHT - 20 * (len(told) - k) - 8))
        if self.mode == "rgb_array":
            return np.transpose(pygame.surfarray.array3d(surface), (1, 0, 2))
        pygame.event.pump()
        pygame.display.flip()
        self._clock.tick(FRAMES)
        return None

    def _open(self) -> Any:
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        try:
            import pygame
        except ImportError:
            raise ModuleNotFoundError("drawing needs pygame: pip install pygame") from None
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
        """Close the window, if there is one."""
        if self._surface is not None and self.mode == "human":
            import pygame

            pygame.display.quit()
        self._forget()
