#!/usr/bin/env bash
# Makes the pictures of the window, of a plan's page and of projections in docs/images/ from a scene and its cameras. Needs
# Xvfb, ImageMagick and Chromium (packages xvfb, imagemagick and chromium), and a release build.
# Usage: docs/pictures.sh SCENE.ply CAMERAS.json
set -euo pipefail
cd "$(dirname -- "${BASH_SOURCE[0]}")/.."
scene=$(realpath -- "$1") cameras=$(realpath -- "$2")
program=${SPLATGRAPH:-target/release/splatgraph}

# The film of the README: the demo scene, which needs no display.
"$program" video --eye 1.6,-1.3,-5.6 --target 0.14,-0.715,-0.477 --fov 57 --orbit 28 --size 200x112 --fps 8 -o docs/images/film.gif

# The pictures of docs/projections.md.
"$program" render -p orthographic --eye 1.6,-1.3,-5.6 --target 0.14,-0.715,-0.477 --ortho-height 3.6 --size 480x270 -o docs/images/orthographic.png
"$program" render -p fisheye --eye 0.3,-1.6,-2.2 --target 0.14,-0.6,0 --fov 200 --size 480x480 -o docs/images/fisheye.png
"$program" render -p equirectangular --eye 0.3,-0.9,-1.6 --target 0.14,-0.8,0 --size 640x320 -o docs/images/equirectangular.png

shoot() { # name, width x height, options
  local name=$1 size=$2
  shift 2
  xvfb-run -a -s "-screen 0 2560x1440x24" "$program" view "$scene" --cameras "$cameras" --pipeline "${pipeline:-splat}" --frames 30 \
    --size "$size" --screenshot "docs/images/$name.png" "$@"
}

pipeline=auto shoot view 1600x900 --show parameters,times,timeline,hud
shoot view-light 1280x800 --theme light --show parameters,times,timeline,hud
shoot view-split 1280x800 --compare unsorted --measure --show parameters,hud
# The same scene, sorted by digits of 4 and of 11 bits: the timeline counts the passes.
shoot view-digits-4 1280x800 --set digit_bits=4 --show parameters,timeline
shoot view-digits-11 1280x800 --set digit_bits=11 --show parameters,timeline
shoot view-barrier 1280x800 --select barrier:8 --show inspector,timeline
shoot view-pick 1280x800 --pick 0.5,0.3 --show inspector,hud
pipeline=auto shoot view-select 1280x800 --select-box 0.41,0.43,0.49,0.64 --show hud

folder=$(mktemp -d)
trap 'rm -rf -- "$folder"' EXIT

# The page of a plan, with a barrier opened, and with the sort's repeats unfolded.
"$program" dump digit4 --format html -o "$folder/plan.html"
for page in 'dump#barrier=9' 'dump-unfolded#unfold=order.sort'; do
  chromium --headless --no-sandbox --disable-gpu --hide-scrollbars --window-size=1600,1000 \
    --screenshot="docs/images/${page%%#*}.png" "file://$folder/plan.html#${page#*#}"
done

# A mistake in a file that is being edited.
cp -r pipelines shaders "$folder"
xvfb-run -a -s "-screen 0 1280x800x24" bash -c '
  "$1" view "$2" --cameras "$3" --size 1280x800 --show parameters --pipeline "$4/pipelines/splat.ron" 2>/dev/null & window=$!
  sleep 8
  sed -i "s/\"digit_bits\": \"digit_bits\"/\"digit_bits\": \"digit_bit\"/" "$4/pipelines/parts/depth_order.ron"
  sleep 4
  import -window root docs/images/view-error.png
  kill "$window"' - "$program" "$scene" "$cameras" "$folder"
