#!/usr/bin/env bash
# Makes the pictures in dashboard/pictures/: a real gateway, four emulated nodes and the real window
# on a display in memory. Needs: xvfb imagemagick xdotool libgl1-mesa-dri and the X11 libraries that
# README names. Arguments: none. Uses the profile dev.
set -euo pipefail
cd "$(dirname "$0")/.."
out=dashboard/pictures
work=$(mktemp -d)
started=()
finish() {
    # Only what was started here.
    for process in "${started[@]}"; do kill "$process" 2>/dev/null || true; done
    wait 2>/dev/null || true
    rm -rf "$work"
}
trap finish EXIT

cargo build --quiet -p gateway -p emulator -p dashboard --bins
bin=${CARGO_TARGET_DIR:-target}/debug
address=tcp/127.0.0.1:${PORT:-17447}
export DISPLAY=:${DISPLAY_NUMBER:-97} LIBGL_ALWAYS_SOFTWARE=1

# Waits until the command says yes; gives up after 60 s.
await() {
    for _ in $(seq 600); do "$@" >/dev/null 2>&1 && return; sleep 0.1; done
    echo "never: $*" >&2
    exit 1
}
start() { "$@" >>"$work/log" 2>&1 & started+=($!); }
fleet() { "$bin/fleet" --connect "$address" "$@"; }
picture() { sleep 2; import -window root +dither -colors 64 -define png:compression-level=9 -define png:compression-filter=0 "$out/$1.png"; }

mkdir -p "$out"
start Xvfb "$DISPLAY" -screen 0 1440x860x24
await xdotool getdisplaygeometry
start "$bin/fleet" serve --store "$work/fleet.redb" --listen "$address"
await fleet nodes
start "$bin/emulator" --nodes 4 --connect "$address"
await sh -c "'$bin/fleet' --connect $address nodes | grep -q node-4.*idle"
start "$bin/dashboard" --connect "$address" --settings "$work/settings.ron"
await xdotool search --name Stepfleet
xdotool search --name Stepfleet windowsize 1440 860 windowmove 0 0

cat >"$work/job.json" <<'JOB'
{"commands":[
  {"ramp":{"axis":0,"steps":40000,"speed_hz":4000,"accel":4000}},
  {"ramp":{"axis":1,"steps":-20000,"speed_hz":3000,"accel":3000}},
  {"ramp":{"axis":0,"steps":-40000,"speed_hz":4000,"accel":4000}}]}
JOB
for node in node-1 node-2 node-3; do fleet submit --node "$node" "$work/job.json" >/dev/null; done
sleep 8
# The page of the first node opens by a click on its name.
xdotool mousemove "${CLICK_X:-250}" "${CLICK_Y:-140}" click 1
picture fleet
# Without a window manager nobody gives the window the keyboard.
xdotool search --name Stepfleet windowfocus
xdotool key F1
picture stop
