#!/usr/bin/env bash
# Build Docker Compose from its Go module, to check compose.yaml where no Docker is installed; prints the binary's path.
set -euo pipefail

VERSION=2.40.3
HERE=$(cd "$(dirname "$0")" && pwd)
CACHE=${XDG_CACHE_HOME:-$HOME/.cache}/hvac-fdd/compose
BINARY=$CACHE/docker-compose-$VERSION

if [ ! -x "$BINARY" ]; then
    command -v go >/dev/null || { echo "docker compose $VERSION needs 'go' to build and there is none in PATH; install it" >&2; exit 1; }
    mkdir -p "$CACHE"
    SCRATCH=$(mktemp -d "${TMPDIR:-/tmp}/compose-build.XXXXXX")
    cleanup() { chmod -R u+w "$SCRATCH" && rm -rf "$SCRATCH"; }    # Go's module cache is read-only
    trap cleanup EXIT
    cp "$HERE/go.mod" "$HERE/go.sum" "$SCRATCH/"
    cd "$SCRATCH"
    echo "building docker compose $VERSION: about 3 minutes on 2 cores, once" >&2
    GOMODCACHE=$SCRATCH/mod GOCACHE=$SCRATCH/gocache GOFLAGS=-mod=mod \
        nice go build -trimpath -ldflags "-s -w" -o "$BINARY.new" github.com/docker/compose/v2/cmd >&2
    mv "$BINARY.new" "$BINARY"
fi
echo "$BINARY"
