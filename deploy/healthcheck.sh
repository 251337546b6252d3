#!/bin/sh
# Healthy: the daemon has taken in samples, or saved its state, within the last FDD_SILENT_MINUTES (45).
# Its journal is written before anything else is done with a batch, so a daemon that hangs stops writing it.
set -eu
folder=${FDD_STATE:-/var/lib/hvac-fdd}
found=$(find "$folder" -maxdepth 2 -name '*.state.sqlite*' -mmin "-${FDD_SILENT_MINUTES:-45}" | head -n 1)
if [ -z "$found" ]; then
    echo "no state in $folder is younger than ${FDD_SILENT_MINUTES:-45} minutes: the daemon or all its sources have stopped"
    exit 1
fi
