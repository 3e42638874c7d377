#!/usr/bin/env node
// A unit of cfgplan in Node.js, without a package: the moving average of the number of bright pixels.
"use strict";

const last = [];
const most = JSON.parse(process.env.CFGPLAN_PARAMS).last;
const say = (message) => process.stdout.write(JSON.stringify(message) + "\n");

say({ ready: true });
require("readline")
  .createInterface({ input: process.stdin })
  .on("line", (line) => {
    const { step, inputs } = JSON.parse(line);
    last.push(inputs.bright);
    if (last.length > most) last.shift();
    say({ step, outputs: { level: last.reduce((sum, each) => sum + each, 0) / last.length } });
  });
