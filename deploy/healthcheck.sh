#!/bin/sh
# Healthy: the daemon's own health endpoint says so (FDD_HEALTH, where the site file has `metrics`): its loop has come
# round within the last minute. Without the endpoint: it has taken in samples, or saved its state, within the last
# FDD_SILENT_MINUTES (45). Its journal is written before anything else is done with a batch.
set -eu
if [ -n "${FDD_HEALTH:-}" ]; then
    exec python3 -c 'import sys, urllib.request; urllib.request.urlopen(sys.argv[1], timeout=5)' "$FDD_HEALTH"
fi
folder=${FDD_STATE:-/var/lib/hvac-fdd}
found=$(find "$folder" -maxdepth 2 -name '*.state.sqlite*' -mmin "-${FDD_SILENT_MINUTES:-45}" | head -n 1)
if [ -z "$found" ]; then
    echo "no state in $folder is younger than ${FDD_SILENT_MINUTES:-45} minutes: the daemon or all its sources have stopped"
    exit 1
fi
