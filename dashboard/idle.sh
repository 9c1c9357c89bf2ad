#!/usr/bin/env bash
# What the window costs while nobody touches it: processor time of the real program on a display in
# memory, with the drawing that a graphics card would do done in software, so it is an upper bound.
# Needs what screenshots.sh needs. Arguments: seconds for each line (20), nodes (200). Profile release.
set -euo pipefail
cd "$(dirname "$0")/.."
seconds=${1:-20} nodes=${2:-200}
profile=release port=${PORT:-17448} display=${DISPLAY_NUMBER:-98}
. dashboard/display.sh
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

start_display
start_window
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
