#!/bin/sh
# Compile mask.c if it is newer than ./mask, then replace this shell by ./mask.
cd "$(dirname "$0")" || exit 1
if [ ! -x mask ] || [ mask.c -nt mask ]; then
    "${CC:-cc}" -O3 -o "mask.$$" mask.c && mv "mask.$$" mask || exit 1
fi
exec ./mask "$@"
