#!/bin/sh
# A unit of cfgplan as a shell pipeline: jq reads the lines, and writes one for each. $1 is the level of the alarm.
echo '{"ready": true}'
exec jq --compact-output --unbuffered --argjson most "$1" '{step, outputs: {alarm: (.inputs.level > $most)}}'
