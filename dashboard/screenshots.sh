#!/usr/bin/env bash
# Makes the pictures in dashboard/pictures/: a real gateway, four emulated nodes and the real window
# on a display in memory. Needs: xvfb imagemagick xdotool libgl1-mesa-dri and the X11 libraries that
# README names. Arguments: none. Uses the profile dev.
set -euo pipefail
cd "$(dirname "$0")/.."
out=dashboard/pictures
profile=dev port=${PORT:-17447} display=${DISPLAY_NUMBER:-97}
. dashboard/display.sh
picture() { sleep 2; import -window root +dither -colors 64 -define png:compression-level=9 -define png:compression-filter=0 "$out/$1.png"; }

mkdir -p "$out"
start_display
start "$bin/fleet" serve --store "$work/fleet.redb" --listen "$address"
await fleet nodes
start "$bin/emulator" --nodes 4 --connect "$address"
await sh -c "'$bin/fleet' --connect $address nodes | grep -q node-4.*idle"
start_window

cat >"$work/job.json" <<'JOB'
{"commands":[
  {"ramp":{"axis":0,"steps":40000,"speed_hz":4000,"accel":4000}},
  {"ramp":{"axis":1,"steps":-20000,"speed_hz":3000,"accel":3000}},
  {"ramp":{"axis":0,"steps":-40000,"speed_hz":4000,"accel":4000}}]}
JOB
for node in node-1 node-2 node-3; do fleet submit --node "$node" "$work/job.json" >/dev/null; done
sleep 8
# The page of the first node opens by a click on its name.
xdotool mousemove "${CLICK_X:-285}" "${CLICK_Y:-140}" click 1
picture fleet
# Without a window manager nobody gives the window the keyboard.
xdotool search --name Stepfleet windowfocus
xdotool key F1
picture stop
