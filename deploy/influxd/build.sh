#!/usr/bin/env bash
# Build the InfluxDB 2 server from its Go module, for machines that cannot run the official container image.
#
#   deploy/influxd/build.sh          prints the path of the binary; builds it only where the cache has none
#
# Needs Go 1.24 or later, Rust (the query language's parser), a C compiler and 3 GB of scratch, which is removed again.
# The binary holds no web interface; the API is complete.
set -euo pipefail

VERSION=2.7.12
HERE=$(cd "$(dirname "$0")" && pwd)
CACHE=${XDG_CACHE_HOME:-$HOME/.cache}/hvac-fdd/influxd
BINARY=$CACHE/influxd-$VERSION

if [ -x "$BINARY" ]; then
    echo "$BINARY"
    exit 0
fi
for tool in go cargo cc; do
    command -v "$tool" >/dev/null || {
        echo "influxd $VERSION needs '$tool' to build and there is none in PATH; install it, or run the official influxdb:2.7 image" >&2
        exit 1
    }
done

mkdir -p "$CACHE"
exec 9>"$CACHE/lock"
flock 9    # two builds at once would do the same work twice
if [ -x "$BINARY" ]; then
    echo "$BINARY"
    exit 0
fi

SCRATCH=${INFLUXD_SCRATCH:-$(mktemp -d "${TMPDIR:-/tmp}/influxd-build.XXXXXX")}
mkdir -p "$SCRATCH"
cleanup() { chmod -R u+w "$SCRATCH" && rm -rf "$SCRATCH"; }    # Go's module cache is read-only
trap cleanup EXIT

cp "$HERE/go.mod" "$HERE/go.sum" "$SCRATCH/"
# The module pins an old Rust and denies its warnings; a newer compiler has more of them.
printf '#!/bin/sh\nexec "$@" --cap-lints warn\n' >"$SCRATCH/rustc-lint-cap.sh"
chmod +x "$SCRATCH/rustc-lint-cap.sh"

export GOBIN=$SCRATCH/bin GOMODCACHE=$SCRATCH/mod GOCACHE=$SCRATCH/gocache GOFLAGS=-mod=mod
export PKG_CONFIG=$SCRATCH/bin/pkg-config RUSTC_WRAPPER=$SCRATCH/rustc-lint-cap.sh RUSTUP_TOOLCHAIN=${RUSTUP_TOOLCHAIN:-stable}
cd "$SCRATCH"
echo "building influxd $VERSION: about 7 minutes on 2 cores, once" >&2
nice go install github.com/influxdata/pkg-config >&2
nice go install -trimpath -ldflags "-s -w -X main.version=v$VERSION" -tags sqlite_foreign_keys,sqlite_json \
    github.com/influxdata/influxdb/v2/cmd/influxd >&2

"$GOBIN/influxd" version >&2
mv "$GOBIN/influxd" "$BINARY.new"
mv "$BINARY.new" "$BINARY"    # in one step, so a half-written file is never found
echo "$BINARY"
