#!/usr/bin/env bash
# What the window costs while nobody touches it: processor time of the real program on a display in
# memory, with the drawing that a graphics card would do done in software, so it is an upper bound.
# Needs what screenshots.sh needs. Arguments: seconds for each line (20), nodes (200). Profile release.
set -euo pipefail
cd "$(dirname "$0")/.."
seconds=${1:-20} nodes=${2:-200}
work=$(mktemp -d)
started=()
finish() {
    # Only what was started here.
    for process in "${started[@]}"; do kill "$process" 2>/dev/null || true; done
    wait 2>/dev/null || true
    rm -rf "$work"
}
trap finish EXIT

cargo build --quiet --release -p gateway -p emulator -p dashboard --bins
bin=${CARGO_TARGET_DIR:-target}/release
address=tcp/127.0.0.1:${PORT:-17448}
export DISPLAY=:${DISPLAY_NUMBER:-98} LIBGL_ALWAYS_SOFTWARE=1

# Waits until the command says yes; gives up after 60 s.
await() {
    for _ in $(seq 600); do "$@" >/dev/null 2>&1 && return; sleep 0.1; done
    echo "never: $*" >&2
    exit 1
}
start() { "$@" >>"$work/log" 2>&1 & started+=($!); }
fleet() { "$bin/fleet" --connect "$address" "$@"; }
all_are() { [ "$(fleet nodes | grep -c "$1")" -ge "$nodes" ]; }
# Ticks of 10 ms that the window has had.
spent() { awk '{ sub(/.*\) /, ""); print $12 + $13 }' "/proc/$window/stat"; }
line() {
    sleep 3
    local before after
    before=$(spent)
    sleep "$seconds"
    after=$(spent)
    awk -v what="$1" -v ticks=$((after - before)) -v s="$seconds" \
        'BEGIN { printf "%-44s %5.1f %% of a core\n", what, ticks / s }'
}

start Xvfb "$DISPLAY" -screen 0 1440x860x24
await xdotool getdisplaygeometry
start "$bin/dashboard" --connect "$address" --settings "$work/settings.ron"
window=$!
await xdotool search --name Stepfleet
xdotool search --name Stepfleet windowsize 1440 860 windowmove 0 0
line "no gateway"
start "$bin/fleet" serve --store "$work/fleet.redb" --listen "$address"
await fleet nodes
line "a gateway, no nodes"
start "$bin/emulator" --nodes "$nodes" --connect "$address"
await all_are idle
line "$nodes nodes at rest, a status a second each"
echo '{"commands":[{"pause":{"ms":3600000}}]}' >"$work/job.json"
fleet submit --node '*' "$work/job.json" >/dev/null
await all_are running
line "$nodes nodes busy, ten statuses a second each"
