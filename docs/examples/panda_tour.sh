#!/usr/bin/env bash
# Five minutes with a ROS 2 bag of a Panda and its URDF: in, looked at, explained, improved, taken home.
#
# HIL_DATA names the folder of the public recordings (docs/results.md says where they come from).
# The bag calls its joints fer_joint1.., the URDF panda_joint1..: they are matched.
set -euo pipefail
bag="$HIL_DATA/ros2_bags/panda_exciting_trajectory.db3"
urdf="$HIL_DATA/panda_30hz/robot.urdf"
out="${1:-panda-tour}"
mkdir -p "$out"

hil import "$bag" --robot "$urdf" --tag panda -o "$out/panda.mcap"
hil list "$out" --tag panda
hil compare "$out/panda.mcap" --report "$out/compare.html"
hil improve "$out/panda.mcap" -o "$out/better.toml" --report "$out/why.html"
hil export "$out/better.toml" --to c -o "$out/feedforward.h" --data "$out/panda.mcap" --feasible
