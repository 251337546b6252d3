#!/usr/bin/env bash
# Make the secrets that compose.yaml mounts, once; what is there stays. The folder is closed to other users of this
# machine; the files in it are readable, because each is mounted into a container that runs as a user of its own.
set -euo pipefail
cd "$(dirname "$0")"
umask 077
mkdir -p secrets
random() { head -c 32 /dev/urandom | od -An -tx1 | tr -d ' \n'; }
for name in influx-admin.password influx-admin.token grafana-admin.password zenoh.password; do
    if [ ! -s "secrets/$name" ]; then
        random >"secrets/$name"
        echo "made secrets/$name"
    fi
done
if [ ! -s secrets/zenoh.users ]; then
    printf 'fdd:%s\ngateway:%s\noperator:%s\n' "$(cat secrets/zenoh.password)" "$(random)" "$(random)" >secrets/zenoh.users
    echo "made secrets/zenoh.users; the gateway of the BMS logs in as 'gateway' with the password in it"
fi
chmod 0444 secrets/*
chmod 0700 secrets
