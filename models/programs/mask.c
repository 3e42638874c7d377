/* A unit of cfgplan in C, without a library: it maps an image to a mask, 255 where the image is bright, else 0.

       cc -O3 -o mask mask.c
       source: program:./mask LEVEL OUTPUT [COUNT]     with     run: {format: msgpack}

   OUTPUT is the output port of the image, COUNT that of the number of its bright pixels. Anything but an array of bytes
   is passed on as it is. The messages are those of the manual's page `programs`: the mark C1 "CFG", the length of the
   payload as 4 bytes, and the payload: the length of the msgpack as 4 bytes, the msgpack, and the bytes of the arrays. */

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct { const uint8_t *at, *end; } Reader; /* the unread rest of a msgpack message */

static void fail(const char *why) {
    fprintf(stderr, "mask: %s\n", why);
    exit(1);
}

static const uint8_t *take(Reader *reader, size_t count) {
    const uint8_t *taken = reader->at;
    if ((size_t)(reader->end - reader->at) < count) fail("a message ends too early");
    reader->at += count;
    return taken;
}

/* Numbers of msgpack are big-endian, lengths of frames little-endian. */
static uint64_t number(Reader *reader, size_t bytes) {
    const uint8_t *from = take(reader, bytes);
    uint64_t value = 0;
    for (size_t n = 0; n < bytes; n++) value = value << 8 | from[n];
    return value;
}

static uint32_t length(const uint8_t *from) {
    return from[0] | from[1] << 8 | from[2] << 16 | (uint32_t)from[3] << 24;
}

static void put_length(uint8_t *to, uint32_t value) {
    for (int n = 0; n < 4; n++) to[n] = value >> 8 * n & 255;
}

/* Skip one value, including nested ones. */
static void skip(Reader *reader) {
    uint8_t kind = *take(reader, 1);
    uint64_t inside = 0, bytes = 0;
    if (kind < 0x80 || kind >= 0xe0 || (kind >= 0xc0 && kind <= 0xc3)) return;  /* small numbers, nil, false, true */
    if (kind < 0x90) inside = 2 * (kind & 15);                                  /* maps, lists and texts that are small */
    else if (kind < 0xa0) inside = kind & 15;
    else if (kind < 0xc0) bytes = kind & 31;
    else if (kind <= 0xc6) bytes = number(reader, 1 << (kind - 0xc4));          /* bytes */
    else if (kind <= 0xc9) bytes = number(reader, 1 << (kind - 0xc7)) + 1;      /* extensions */
    else if (kind <= 0xcb) bytes = 4 << (kind - 0xca);                          /* numbers */
    else if (kind <= 0xd3) bytes = 1 << (kind & 3);
    else if (kind <= 0xd8) bytes = (1 << (kind - 0xd4)) + 1;                    /* extensions of a fixed length */
    else if (kind <= 0xdb) bytes = number(reader, 1 << (kind - 0xd9));          /* texts, lists and maps that are large */
    else if (kind <= 0xdd) inside = number(reader, 2 << (kind - 0xdc));
    else inside = 2 * number(reader, 2 << (kind - 0xde));
    take(reader, bytes);
    while (inside--) skip(reader);
}

static uint64_t count_of_map(Reader *reader) {
    uint8_t kind = *take(reader, 1);
    if (kind == 0xde) return number(reader, 2);
    if (kind < 0x80 || kind > 0x8f) fail("there is no map where one should be");
    return kind & 15;
}

/* Read the next key; return whether it is this text. */
static int is_key(Reader *reader, const char *text) {
    const uint8_t *key = reader->at;
    skip(reader);
    return key[0] == (0xa0 | strlen(text)) && !memcmp(key + 1, text, strlen(text));
}

static void read_all(uint8_t *to, size_t count) {
    if (fread(to, 1, count, stdin) != count) fail("the input ends within a message");
}

static void put_text(uint8_t **to, const char *text) {
    *(*to)++ = 0xa0 | strlen(text); /* texts of up to 31 bytes */
    memcpy(*to, text, strlen(text));
    *to += strlen(text);
}

static void answer(const uint8_t *msgpack, size_t bytes, const uint8_t *arrays, size_t array_bytes) {
    uint8_t head[12] = {0xc1, 'C', 'F', 'G'};
    size_t padding = array_bytes ? -(4 + bytes) & 15 : 0; /* the arrays begin at a multiple of 16 */
    put_length(head + 4, 4 + bytes + padding + array_bytes);
    put_length(head + 8, bytes);
    fwrite(head, 1, sizeof head, stdout);
    fwrite(msgpack, 1, bytes, stdout);
    fwrite("\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0", 1, padding, stdout);
    fwrite(arrays, 1, array_bytes, stdout);
    fflush(stdout);
}

int main(int argc, char **argv) {
    if (argc < 3 || strlen(argv[2]) > 31 || (argc > 3 && strlen(argv[3]) > 31)) fail("usage: mask LEVEL OUTPUT [COUNT]");
    int level = atoi(argv[1]);
    uint8_t *payload = NULL, *made = NULL, head[8];
    static char buffer[1 << 16];
    setvbuf(stdin, buffer, _IOFBF, sizeof buffer);
    answer((const uint8_t *)"\x81\xa5ready\xc3", 8, NULL, 0);
    while (fread(head, 1, sizeof head, stdin) == sizeof head) {
        size_t bytes = length(head + 4), msgpack;
        if (memcmp(head, "\xc1" "CFG", 4) || bytes < 4) fail("there is no message where one should be");
        if (!(payload = realloc(payload, bytes)) || !(made = realloc(made, bytes + 128))) fail("no memory is left");
        read_all(payload, bytes);
        if ((msgpack = length(payload)) > bytes - 4) fail("a message is longer than its frame");
        Reader reader = {payload + 4, payload + 4 + msgpack}, step = {0}, value = {0};
        for (uint64_t left = count_of_map(&reader); left--;) {
            Reader key = reader;
            skip(&reader);
            Reader said = reader;
            skip(&reader);
            said.end = reader.at;
            if (is_key(&(Reader){key.at, key.end}, "step")) step = said;
            if (is_key(&key, "inputs") && count_of_map(&said)) { /* the value of the first input, whatever its name */
                skip(&said);
                value = (Reader){said.at, said.end};
                skip(&said);
                value.end = said.at;
            }
        }
        if (!step.at || !value.at) fail("a message lacks its step or its input");

        uint8_t *arrays = payload + 4 + msgpack + (-(4 + msgpack) & 15), *end = payload + bytes;
        size_t array_bytes = arrays < end ? end - arrays : 0;
        uint32_t bright = 0;
        for (size_t n = 0; n < array_bytes; n++) {
            bright += arrays[n] >= level;
            arrays[n] = arrays[n] >= level ? 255 : 0;
        }

        uint8_t *to = made;
        *to++ = 0x82; /* {"step": ..., "outputs": {OUTPUT: ..., COUNT: ...}} */
        put_text(&to, "step");
        memcpy(to, step.at, step.end - step.at);
        to += step.end - step.at;
        put_text(&to, "outputs");
        *to++ = 0x80 | (argc > 3 ? 2 : 1);
        put_text(&to, argv[2]);
        memcpy(to, value.at, value.end - value.at);
        to += value.end - value.at;
        if (argc > 3) {
            put_text(&to, argv[3]);
            *to++ = 0xce;
            for (int n = 3; n >= 0; n--) *to++ = bright >> 8 * n & 255;
        }
        answer(made, to - made, arrays, array_bytes);
    }
    return 0;
}
