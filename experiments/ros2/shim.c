/* Moves a live subscription of an unmodified ROS 2 node to another topic: an experiment, no part of the product.
 *
 * LD_PRELOAD puts it in front of the middleware's library. Orders come as lines "OWN_TOPIC NEW_TOPIC stamp|cut" on the
 * unix socket CFGPLAN_SHIM; each is answered by "switched PUBLISHERS" or "failed".
 *
 * "stamp" hands over by the first field of the messages, a std_msgs/Header: the old reader is read until it is past the
 * first stamp of the new one, and nothing is given twice. "cut" changes readers at once.
 *
 * Not covered: intra-process communication, loaned messages, several threads that wait, middlewares but Fast DDS.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>
#include "rmw/event.h"
#include "rmw/rmw.h"

#define MOST 256
#define REAL(name) ((__typeof__(&name))found(#name))
#define SILENT_MS 500 /* Without a message of the old reader for so long, the new one takes over. */
#define ENCAPSULATION 4 /* Bytes before a serialised message. */

static void *found(const char *name) {
  static void *library;
  if (!library) library = dlopen("librmw_implementation.so", RTLD_NOW);
  if (!library) library = dlopen("librmw_fastrtps_cpp.so", RTLD_NOW);
  void *function = library ? dlsym(library, name) : 0;
  if (!function) { fprintf(stderr, "shim: the middleware has no %s\n", name); abort(); }
  return function;
}

typedef struct {
  rmw_subscription_t *own;      /* The node's. */
  rmw_subscription_t *standby;  /* The reader of the new topic, until it has taken over. */
  const rmw_node_t *node;
  const rosidl_message_type_support_t *type;
  rmw_qos_profile_t qos;
  rmw_subscription_options_t options;
  char topic[256];
  int64_t last_ns;              /* The stamp of the last message that the node got. */
  int64_t skipped_to_ns;        /* After a hand-over: older messages have been given already. */
  rmw_serialized_message_t first; /* The first message of the new topic. */
  int has_first;
} Subscription;

static Subscription subscriptions[MOST];
static int number_of_subscriptions;
static const rmw_guard_condition_t *guards[MOST];
static int number_of_guards;
static struct { rmw_event_t *event; const rmw_subscription_t *of; } events[4 * MOST]; /* They hold the reader too. */
static int number_of_events;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER; /* Of all that stands above. */
static atomic_ulong waits;

/* A serialised message resizes itself by its allocator. */
static void *allocate(size_t size, void *state) { (void)state; return malloc(size); }
static void release(void *at, void *state) { (void)state; free(at); }
static void *resize(void *at, size_t size, void *state) { (void)state; return realloc(at, size); }
static void *cleared(size_t number, size_t size, void *state) { (void)state; return calloc(number, size); }

static int64_t stamp_of(const void *header) {
  int32_t seconds; uint32_t nanoseconds;
  memcpy(&seconds, header, 4);
  memcpy(&nanoseconds, (const char *)header + 4, 4);
  return seconds * 1000000000LL + nanoseconds;
}

static Subscription *of(const rmw_subscription_t *own) {
  for (int i = 0; i < number_of_subscriptions; i++) if (subscriptions[i].own == own) return &subscriptions[i];
  return 0;
}

static void *serve(void *unused);

rmw_subscription_t *rmw_create_subscription(const rmw_node_t *node, const rosidl_message_type_support_t *type,
    const char *topic, const rmw_qos_profile_t *qos, const rmw_subscription_options_t *options) {
  static int is_serving;
  rmw_subscription_t *made = REAL(rmw_create_subscription)(node, type, topic, qos, options);
  pthread_mutex_lock(&lock);
  if (made && number_of_subscriptions < MOST) {
    Subscription *one = &subscriptions[number_of_subscriptions++];
    *one = (Subscription){.own = made, .node = node, .type = type, .qos = *qos, .options = *options,
                          .last_ns = INT64_MIN, .skipped_to_ns = INT64_MIN};
    one->first.allocator = (rcutils_allocator_t){allocate, release, resize, cleared, 0};
    snprintf(one->topic, sizeof one->topic, "%s", topic);
  }
  if (!is_serving && getenv("CFGPLAN_SHIM")) {
    pthread_t thread;
    is_serving = !pthread_create(&thread, 0, serve, 0);
  }
  pthread_mutex_unlock(&lock);
  return made;
}

rmw_ret_t rmw_destroy_subscription(rmw_node_t *node, rmw_subscription_t *own) {
  pthread_mutex_lock(&lock);
  Subscription *one = of(own);
  if (one) *one = subscriptions[--number_of_subscriptions];
  pthread_mutex_unlock(&lock);
  return REAL(rmw_destroy_subscription)(node, own);
}

rmw_ret_t rmw_subscription_event_init(rmw_event_t *event, const rmw_subscription_t *own, rmw_event_type_t type) {
  rmw_ret_t result = REAL(rmw_subscription_event_init)(event, own, type);
  pthread_mutex_lock(&lock);
  if (result == RMW_RET_OK && number_of_events < 4 * MOST) {
    events[number_of_events].event = event;
    events[number_of_events++].of = own;
  }
  pthread_mutex_unlock(&lock);
  return result;
}

rmw_ret_t rmw_event_fini(rmw_event_t *event) {
  pthread_mutex_lock(&lock);
  for (int i = 0; i < number_of_events; i++)
    if (events[i].event == event) { events[i] = events[--number_of_events]; break; }
  pthread_mutex_unlock(&lock);
  return REAL(rmw_event_fini)(event);
}

rmw_guard_condition_t *rmw_create_guard_condition(rmw_context_t *context) {
  rmw_guard_condition_t *made = REAL(rmw_create_guard_condition)(context);
  pthread_mutex_lock(&lock);
  if (made && number_of_guards < MOST) guards[number_of_guards++] = made;
  pthread_mutex_unlock(&lock);
  return made;
}

rmw_ret_t rmw_destroy_guard_condition(rmw_guard_condition_t *guard) {
  pthread_mutex_lock(&lock);
  for (int i = 0; i < number_of_guards; i++)
    if (guards[i] == guard) { guards[i] = guards[--number_of_guards]; break; }
  pthread_mutex_unlock(&lock);
  return REAL(rmw_destroy_guard_condition)(guard);
}

rmw_ret_t rmw_wait(rmw_subscriptions_t *s, rmw_guard_conditions_t *g, rmw_services_t *r, rmw_clients_t *c,
    rmw_events_t *e, rmw_wait_set_t *set, const rmw_time_t *timeout) {
  rmw_ret_t result = REAL(rmw_wait)(s, g, r, c, e, set, timeout);
  atomic_fetch_add(&waits, 1);
  return result;
}

/* Give the node's subscription the new reader; `standby` then has the old one. The lock is held. */
static void swap_readers(Subscription *one) {
  rmw_subscription_t *own = one->own, *other = one->standby, old = *own;
  own->data = other->data; own->topic_name = other->topic_name;
  other->data = old.data; other->topic_name = old.topic_name;
  for (int i = 0; i < number_of_events; i++) if (events[i].of == own) events[i].event->data = own->data;
  one->standby = 0;
  one->skipped_to_ns = one->last_ns;
}

/* Take the next message that the node shall get. The lock is held. */
static rmw_ret_t next(Subscription *one, void *message, bool *taken, rmw_message_info_t *info,
    rmw_subscription_allocation_t *allocation) {
  if (one->standby && !one->has_first) {
    bool has_one = false;
    (void)!REAL(rmw_take_serialized_message)(one->standby, &one->first, &has_one, 0);
    one->has_first = has_one;
    if (has_one && stamp_of(one->first.buffer + ENCAPSULATION) <= one->last_ns) swap_readers(one); /* It is behind. */
  }
  for (;;) {
    if (one->has_first && !one->standby) { /* It has taken over: its first message comes first. */
      one->has_first = 0;
      if (stamp_of(one->first.buffer + ENCAPSULATION) <= one->skipped_to_ns) continue;
      *taken = REAL(rmw_deserialize)(&one->first, one->type, message) == RMW_RET_OK;
      if (*taken) one->last_ns = stamp_of(message);
      return RMW_RET_OK;
    }
    rmw_ret_t result = REAL(rmw_take_with_info)(one->own, message, taken, info, allocation);
    if (result != RMW_RET_OK || !*taken) return result;
    int64_t now_ns = stamp_of(message);
    if (one->standby && one->has_first && now_ns >= stamp_of(one->first.buffer + ENCAPSULATION)) {
      swap_readers(one); /* The new topic has this message and the ones before it. */
      continue;
    }
    if (!one->standby && now_ns <= one->skipped_to_ns) continue;
    one->last_ns = now_ns;
    return result;
  }
}

rmw_ret_t rmw_take_with_info(const rmw_subscription_t *own, void *message, bool *taken, rmw_message_info_t *info,
    rmw_subscription_allocation_t *allocation) {
  pthread_mutex_lock(&lock);
  Subscription *one = of(own);
  int is_led = one && (one->standby || one->has_first || one->skipped_to_ns != INT64_MIN);
  rmw_ret_t result = is_led ? next(one, message, taken, info, allocation)
                            : REAL(rmw_take_with_info)(own, message, taken, info, allocation);
  if (one && !is_led && result == RMW_RET_OK && *taken) one->last_ns = stamp_of(message);
  pthread_mutex_unlock(&lock);
  return result;
}

static void wake_all(void) {
  pthread_mutex_lock(&lock);
  for (int i = 0; i < number_of_guards; i++) (void)!REAL(rmw_trigger_guard_condition)(guards[i]);
  pthread_mutex_unlock(&lock);
}

/* Returns the number of publishers on the new topic; -1 if the subscription can't be moved. */
static int move(const char *topic, const char *to, int by_stamp) {
  Subscription *one = 0;
  pthread_mutex_lock(&lock);
  for (int i = 0; i < number_of_subscriptions; i++)
    if (!strcmp(subscriptions[i].topic, topic) && !subscriptions[i].standby) one = &subscriptions[i];
  pthread_mutex_unlock(&lock);
  rmw_subscription_t *other =
      one ? REAL(rmw_create_subscription)(one->node, one->type, to, &one->qos, &one->options) : 0;
  if (!other) return -1;
  size_t publishers = 0;
  for (int ms = 0; ms < 5000 && !publishers; ms++) {
    (void)!REAL(rmw_subscription_count_matched_publishers)(other, &publishers);
    if (!publishers) usleep(1000);
  }
  pthread_mutex_lock(&lock);
  one->standby = other;
  one->has_first = 0;
  if (!by_stamp) { swap_readers(one); one->skipped_to_ns = INT64_MIN; }
  pthread_mutex_unlock(&lock);
  for (int ms = 0; ms < SILENT_MS; ms++) { /* The node's own thread hands over, when it takes. */
    pthread_mutex_lock(&lock);
    int is_done = !one->standby;
    pthread_mutex_unlock(&lock);
    if (is_done) break;
    usleep(1000);
  }
  pthread_mutex_lock(&lock);
  if (one->standby) swap_readers(one);
  pthread_mutex_unlock(&lock);
  /* A thread may still wait on the old reader: it is destroyed once all have begun to wait anew, else kept. */
  unsigned long before = atomic_load(&waits);
  for (int i = 0; i < 400 && atomic_load(&waits) < before + 3; i++) { wake_all(); usleep(1000); }
  if (atomic_load(&waits) >= before + 3) (void)!REAL(rmw_destroy_subscription)((rmw_node_t *)one->node, other);
  return (int)publishers;
}

static void *serve(void *unused) {
  (void)unused;
  struct sockaddr_un address = {.sun_family = AF_UNIX};
  snprintf(address.sun_path, sizeof address.sun_path, "%s", getenv("CFGPLAN_SHIM"));
  int listener = socket(AF_UNIX, SOCK_STREAM, 0);
  if (bind(listener, (void *)&address, sizeof address) || listen(listener, 1)) return 0;
  for (int end; (end = accept(listener, 0, 0)) >= 0; close(end)) {
    char line[1024], own[256], to[256], way[16], answer[64];
    for (ssize_t size; (size = read(end, line, sizeof line - 1)) > 0;) {
      line[size] = 0;
      int publishers = -1;
      if (sscanf(line, "%255s %255s %15s", own, to, way) == 3) publishers = move(own, to, !strcmp(way, "stamp"));
      int length = snprintf(answer, sizeof answer, publishers < 0 ? "failed\n" : "switched %d\n", publishers);
      if (write(end, answer, length) < 0) break;
    }
  }
  return 0;
}
