/* Answers each line of JSON by the value of its input x, at its output y, as it stands in the text. */

#define _GNU_SOURCE
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int main(void) {
    char *line = NULL;
    size_t room = 0;
    ssize_t length;
    puts("{\"ready\": true}");
    fflush(stdout);
    while ((length = getline(&line, &room, stdin)) > 0) {
        char *step = strstr(line, "\"step\":"), *value = strstr(line, "\"inputs\":{\"x\":");
        if (!step || !value) return 1;
        value += strlen("\"inputs\":{\"x\":");
        printf("{\"step\":%lld,\"outputs\":{\"y\":%.*s}}\n", atoll(step + 7), (int)(line + length - 3 - value), value);
        fflush(stdout);
    }
    return 0;
}
