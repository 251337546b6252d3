"""What a site may want to change: addresses, thresholds, colours. Everything else follows from the schema."""

from __future__ import annotations

DATA_SOURCE = "fdd-influxdb"  # uid of the provisioned data source
TOKEN_FILE = "/run/fdd-tokens/grafana.token"  # as Grafana sees it
FOLDER = "HVAC fault detection"
REPORTS = "/reports"  # where the daemon's reports are served; links in alarm lists start here
RUNBOOK = "https://example.com/hvac-fdd/runbook"  # docs/runbook.md, where the site publishes it

BAND_SD = 2.0  # width of the drawn prediction band, in standard deviations
INNOVATION_BAND = 3.0  # innovations beyond this are drawn in red
SILENT_MINUTES = (
    45  # a frame, its lateness and two scrapes; longer silence means the service or all its sources stopped
)
NO_DATA_SHARE = 0.2  # share of charts without data that is worth a look
LATE_SECONDS = 1800  # how old the newest result may be before the number turns red

GREEN, BLUE, YELLOW, ORANGE, RED, GREY = "green", "blue", "yellow", "orange", "red", "gray"
PHASE_COLOURS = {"no data": GREY, "learning": BLUE, "quiet": GREEN, "alarm": RED}
STATE_COLOURS = {
    "raised": RED,
    "acknowledged": ORANGE,
    "shelved": BLUE,
    "suppressed by design": GREY,
    "returned to normal": YELLOW,
    "cleared": GREEN,
}
SEVERITY_COLOURS = {"info": GREY, "low": BLUE, "medium": YELLOW, "high": ORANGE, "critical": RED}
