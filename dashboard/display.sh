# Sourced by the scripts here: a real gateway and real nodes under a window on a display in memory.
# `profile`, `port` and `display` are set before; `$work` is a folder for the run, removed at its end.
work=$(mktemp -d)
started=()
finish() {
    # Only what was started here.
    for process in "${started[@]}"; do kill "$process" 2>/dev/null || true; done
    wait 2>/dev/null || true
    rm -rf "$work"
}
trap finish EXIT

cargo build --quiet --profile "$profile" -p gateway -p emulator -p dashboard --bins
bin=${CARGO_TARGET_DIR:-target}/${profile/#dev/debug}
address=tcp/127.0.0.1:$port
export DISPLAY=:$display LIBGL_ALWAYS_SOFTWARE=1

# Waits until the command says yes; gives up after 60 s.
await() {
    for _ in $(seq 600); do "$@" >/dev/null 2>&1 && return; sleep 0.1; done
    echo "never: $*" >&2
    exit 1
}
start() { "$@" >>"$work/log" 2>&1 & started+=($!); }
fleet() { "$bin/fleet" --connect "$address" "$@"; }
start_display() {
    start Xvfb "$DISPLAY" -screen 0 1440x860x24
    await xdotool getdisplaygeometry
}
# Starts the window, whose process is then $window, as large as the display.
start_window() {
    start "$bin/dashboard" --connect "$address" --settings "$work/settings.ron"
    window=$!
    await xdotool search --name Stepfleet
    xdotool search --name Stepfleet windowsize 1440 860 windowmove 0 0
}
