#!/bin/sh
# A unit of cfgplan as a shell pipeline: jq maps each line to a line. $1 is the level above which it alarms.
echo '{"ready": true}'
exec jq --compact-output --unbuffered --argjson most "$1" '{step, outputs: {alarm: (.inputs.level > $most)}}'
