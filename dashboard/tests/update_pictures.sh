#!/usr/bin/env bash
# Draws the pictures of tests/snapshots anew and packs them tighter. Look at each before committing it.
set -euo pipefail
cd "$(dirname "$0")/.."
# A picture that differs little is not drawn anew, so all of them go first.
rm -f tests/snapshots/*.png
UPDATE_SNAPSHOTS=1 cargo test -p dashboard --test window picture
for picture in tests/snapshots/*_{dark,light}.png; do
    mogrify -strip -alpha off -define png:color-type=2 -define png:compression-level=9 \
        -define png:compression-filter=2 -define png:compression-strategy=0 "$picture"
done
rm -f tests/snapshots/*.{old,new,diff}.png
