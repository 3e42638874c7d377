"""A unit of cfgplan in plain Python, without cfgplan and without any package: a camera that looks at a lamp.

It is a source with `run: {format: msgpack}` that keeps its own pace, and sends ten images of 480 x 960 bytes a second.
The lamp is on for three seconds, then off for three.
"""

import struct
import sys
import time

HEIGHT, WIDTH = 480, 960
PERIOD_S, LIT_S = 0.1, 3


def text(word):
    return bytes([0xA0 | len(word)]) + word.encode()  # texts of up to 31 bytes


def send(msgpack, array=b""):
    head = struct.pack("<I", len(msgpack)) + msgpack
    if array:
        head += bytes(-len(head) % 16)  # arrays begin at a multiple of 16
    sys.stdout.buffer.write(b"\xc1CFG" + struct.pack("<I", len(head) + len(array)) + head + array)
    sys.stdout.buffer.flush()


def image(lit):
    dark, light = bytes([20]) * WIDTH, bytes([20]) * 400 + bytes([230]) * 160 + bytes([20]) * 400
    return dark * 160 + (light if lit else dark) * 160 + dark * 160


# [type, shape, where the array begins], as numpy says types; an extension of type 1.
ARRAY = b"\x93" + text("|u1") + b"\x92" + struct.pack(">BHBH", 0xCD, HEIGHT, 0xCD, WIDTH) + b"\x00"
ANSWER = b"\x81" + text("outputs") + b"\x81" + text("image") + b"\xc7" + bytes([len(ARRAY), 1]) + ARRAY
IMAGES = [image(False), image(True)]

send(b"\x81" + text("ready") + b"\xc3")
while True:
    now = time.time()
    send(ANSWER, IMAGES[now // LIT_S % 2 == 0])
    time.sleep(PERIOD_S - now % PERIOD_S)
