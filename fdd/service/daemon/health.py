"""Am I watching? What keeps the service from seeing faults, and since when.

===================  ===============================================================================================
problem              is there while
===================  ===============================================================================================
no frames            no frame has closed for :data:`FRAMES` steps, the lateness and a minute
dropped              more than a fifth of the samples of the last ten minutes were dropped
source silent        a source has said nothing for :data:`FRAMES` steps and five minutes
clock                samples are dated ahead of this machine's clock, or this clock stands behind them
store                results wait on disk, or the store's file has gone
blind                a component's filter has not run for a day of event time
failing              in the last hour what goes on beside detection failed, or a journal entry was set aside
===================  ===============================================================================================

States that were stepped back from are told, too, but leave the service healthy: it watches on.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

from fdd.records import JsonObject

FRAMES = 5
DROPPED_SHARE, DROPPED_SECONDS, DROPPED_LEAST = 0.2, 600.0, 20
SILENT_SECONDS, FAILING_SECONDS = 300.0, 3600.0
LOST = ("late", "clock_jump", "unknown_point", "unknown point", "malformed message", "point not allowed")


@dataclass
class Health:
    """Remembers, between two looks, since when what is wrong.

    Parameters
    ----------
    step, lateness : of the site [s]
    """

    step: float
    lateness: float
    _since: dict[str, float] = field(default_factory=dict)
    _frames: tuple[int, float] | None = None
    _counts: deque[tuple[float, int, int]] = field(default_factory=deque)
    _failures: tuple[int, float] | None = None
    _dated: int = 0

    def look(
        self,
        now: float,
        *,
        frames: int,
        samples: int,
        counts: Mapping[str, int],
        heard: Mapping[str, float],
        blind: tuple[str, ...],
        store: str,
        failures: int,
    ) -> list[JsonObject]:
        """What is wrong, with ``what``, ``since`` (wall clock [s]) and ``detail``.

        Parameters
        ----------
        now : wall clock [s]
        frames, samples, failures : so far
        counts : what became of samples, by reason
        heard : source to when it last said something [s]
        blind : components that are not watched
        store : what is wrong with it; empty where nothing is
        """
        found = {
            "no frames": self._no_frames(now, frames),
            "dropped": self._dropped(now, samples, sum(counts.get(k, 0) for k in LOST)),
            "source silent": self._silent(now, heard),
            "clock": self._clock(counts),
            "store": store,
            "blind": f"not watched for a day: {', '.join(blind[:20])}" if blind else "",
            "failing": self._failing(now, failures),
        }
        self._since = {what: self._since.get(what, now) for what, detail in found.items() if detail}
        return [{"what": w, "since": self._since[w], "detail": d} for w, d in found.items() if d]

    def _no_frames(self, now: float, frames: int) -> str:
        if self._frames is None or frames != self._frames[0]:
            self._frames = (frames, now)
        silent = now - self._frames[1]
        patience = FRAMES * self.step + self.lateness + 60.0
        return f"no frame has closed for {silent:.0f} s" if silent > patience else ""

    def _dropped(self, now: float, samples: int, lost: int) -> str:
        self._counts.append((now, samples, lost))
        while now - self._counts[0][0] > DROPPED_SECONDS:
            self._counts.popleft()
        _, before, lost_before = self._counts[0]
        came, dropped = samples - before, lost - lost_before
        if dropped < DROPPED_LEAST or dropped <= DROPPED_SHARE * max(came, dropped):
            return ""
        return f"{dropped} of {max(came, dropped)} samples of the last {DROPPED_SECONDS / 60:.0f} min were dropped"

    def _silent(self, now: float, heard: Mapping[str, float]) -> str:
        patience = FRAMES * self.step + SILENT_SECONDS
        silent = [f"{name} for {now - at:.0f} s" for name, at in heard.items() if now - at > patience]
        return f"silent: {', '.join(silent[:20])}" if silent else ""

    def _clock(self, counts: Mapping[str, int]) -> str:
        dated = counts.get("dated ahead of the clock", 0)
        more, self._dated = dated - self._dated, dated
        return f"{more} samples were dated ahead of this machine's clock: one of the two is wrong" if more > 0 else ""

    def _failing(self, now: float, failures: int) -> str:
        if self._failures is None:
            self._failures = (failures, float("-inf"))  # what was counted before this process is no news
        elif failures != self._failures[0]:
            self._failures = (failures, now)
        recent = now - self._failures[1] < FAILING_SECONDS
        return f"{failures} failures, or journal entries set aside, so far; the log says which" if recent else ""
