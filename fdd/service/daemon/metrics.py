"""``/metrics`` in the text format of Prometheus and ``/health``, from a standard library server on a thread.

The loop publishes a whole document now and then; the server only reads the last one, so that a scrape never waits for
a frame and a frame never for a scrape.
"""

from __future__ import annotations

import json
import socket
import threading
import time as clock
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from fdd.records import JsonObject

# A loop that has not come round for so long hangs.
STALE_SECONDS = 60.0
# Requests at a time, and how long one may take: who opens more, or dawdles, is cut off.
REQUESTS, REQUEST_SECONDS = 16, 5.0
HELP = {
    "fdd_samples_total": ("counter", "Samples taken in."),
    "fdd_frames_total": ("counter", "Frames closed."),
    "fdd_lag_seconds": ("gauge", "Wall clock less the event time of the last closed frame."),
    "fdd_open_alarms": ("gauge", "Alarms that are not cleared."),
    "fdd_alarms_promised_per_year": ("gauge", "False alarms a year that the budget allows."),
    "fdd_watched_years": ("gauge", "Time in which charts could judge."),
    "fdd_alarms_per_year": ("gauge", "Alarms a year, all and those judged false, with their 95 % Poisson interval."),
    "fdd_alarms": ("gauge", "Alarms that came in the time watched, all and those judged false."),
    "fdd_charts": ("gauge", "Charts in each phase."),
    "fdd_counts_total": ("counter", "What became of samples and filters, by reason."),
    "fdd_spool_bytes": ("gauge", "Outputs that wait on disk for the store."),
    "fdd_baseline_version": ("gauge", "Version of the baseline in force."),
    "fdd_job_failures_total": ("counter", "Scheduled jobs that failed."),
    "fdd_healthy": ("gauge", "1 while faults would be seen, 0 while something keeps the service from watching."),
    "fdd_problem_since_seconds": ("gauge", "Wall clock at which a problem began, by what it is."),
    "fdd_buried_total": ("counter", "Journal entries that could not be replayed and were set aside."),
    "fdd_mishaps": ("gauge", "Damaged journals and states since the service was started."),
    "fdd_resident_memory_bytes": ("gauge", "Resident memory of the daemon."),
}


def exposition(status: JsonObject) -> str:
    """The status document as Prometheus' text format 0.0.4."""
    values: dict[str, list[tuple[str, float]]] = {
        "fdd_samples_total": [("", status["samples"])],
        "fdd_frames_total": [("", status["frames"])],
        "fdd_lag_seconds": [("", status["lag_seconds"])] if status.get("lag_seconds") is not None else [],
        "fdd_open_alarms": [("", status["open_alarms"])],
        **_budget(status.get("budget", {})),
        "fdd_charts": [(_label("phase", k), v) for k, v in status["phases"].items()],
        "fdd_counts_total": [(_label("reason", k), v) for k, v in status["counts"].items()],
        "fdd_spool_bytes": [("", status["spool_bytes"])] if status.get("spool_bytes") is not None else [],
        "fdd_baseline_version": [(_label("component", k), v) for k, v in status["baselines"].items()],
        "fdd_job_failures_total": [("", status["job_failures"])],
        "fdd_healthy": [("", float(not status.get("problems", [])))],
        "fdd_problem_since_seconds": [(_label("what", p["what"]), p["since"]) for p in status.get("problems", [])],
        "fdd_buried_total": [("", status.get("buried", 0))],
        "fdd_mishaps": [("", len(status.get("mishaps", [])))],
        "fdd_resident_memory_bytes": [("", status["rss_bytes"])],
    }
    lines = []
    for name, (kind, text) in HELP.items():
        if values.get(name):
            lines += [f"# HELP {name} {text}", f"# TYPE {name} {kind}"]
            lines += [f"{name}{label} {value:.17g}" for label, value in values[name]]
    return "\n".join(lines) + "\n"


def _budget(budget: JsonObject) -> dict[str, list[tuple[str, float]]]:
    """The promised and the realised rate of alarms."""
    if not budget:
        return {}
    which = [(w, budget[w]) for w in ("alarms", "judged_false") if w in budget]
    bounds = ("per_year", "low", "high")
    return {
        "fdd_alarms_promised_per_year": [("", budget["promised_per_year"])],
        "fdd_watched_years": [("", budget["years"])],
        "fdd_alarms": [(_label("which", w), table["count"]) for w, table in which],
        "fdd_alarms_per_year": [
            (_label("which", w)[:-1] + f',bound="{"value" if b == "per_year" else b}"}}', table[b])
            for w, table in which
            for b in bounds
        ],
    }


def _label(name: str, value: str) -> str:
    escaped = value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return f'{{{name}="{escaped}"}}'


class _Server(ThreadingHTTPServer):
    """Answers a bounded number of requests at a time, each within a bounded time."""

    daemon_threads = True
    request_queue_size = 128

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        self._begun: dict[socket.socket, float] = {}
        super().__init__(address, handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        if len(self._begun) >= REQUESTS:
            self.shutdown_request(request)
            return
        self._begun[request] = clock.monotonic()
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        self._begun.pop(request, None)
        super().shutdown_request(request)

    def service_actions(self) -> None:
        """Twice a second: cut off who sends a byte now and then, to stay within every single time-out."""
        for request, begun in list(self._begun.items()):
            if clock.monotonic() - begun > REQUEST_SECONDS:
                self._begun.pop(request, None)
                with suppress(OSError):
                    request.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that goes away is no news."""


class MetricsServer:
    """Serves the last status that was published.

    Parameters
    ----------
    address : host and port; port 0 takes a free one
    """

    def __init__(self, address: tuple[str, int]) -> None:
        self._status: JsonObject | None = None
        self._alive = clock.monotonic()
        outer = self

        class Handler(BaseHTTPRequestHandler):
            timeout = REQUEST_SECONDS

            def do_GET(self) -> None:
                code, kind, body = outer._answer(self.path)
                self.send_response(code)
                self.send_header("Content-Type", kind)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, format: str, *args: object) -> None:
                """A scrape every few seconds is no news."""

        self._server = _Server(address, Handler)
        self.address = (str(self._server.server_address[0]), int(self._server.server_address[1]))
        threading.Thread(target=self._server.serve_forever, daemon=True, name="metrics").start()

    def alive(self) -> None:
        """The loop has come round."""
        self._alive = clock.monotonic()

    def publish(self, status: JsonObject) -> None:
        """What the next requests are told."""
        self._status = status

    def _answer(self, path: str) -> tuple[int, str, bytes]:
        silent = clock.monotonic() - self._alive
        match path.partition("?")[0]:
            case "/metrics":
                text = exposition(self._status) if self._status else ""
                return 200, "text/plain; version=0.0.4; charset=utf-8", text.encode()
            case "/health":
                problems = list((self._status or {}).get("problems", []))
                if silent >= STALE_SECONDS:
                    since = clock.time() - silent
                    problems.append({"what": "hangs", "since": since, "detail": f"no turn for {silent:.0f} s"})
                document = {"healthy": not problems, "problems": problems, "seconds_since_last_turn": round(silent, 1)}
                return 503 if problems else 200, "application/json", json.dumps(document).encode()
            case "/live":
                return (503 if silent >= STALE_SECONDS else 200), "text/plain", f"{silent:.1f}\n".encode()
            case _:
                return 404, "text/plain", b"there are /metrics, /health and /live\n"

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()
