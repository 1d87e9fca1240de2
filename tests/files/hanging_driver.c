/* Wraps the Vulkan loader named by HANGING_REAL. After HANGING_AFTER calls, vkCreateComputePipelines never returns, and the library's
   destructor blocks the exit of the process. */

#include <dlfcn.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

typedef void (*Function)(void);
typedef Function (*Lookup)(void *, const char *);
typedef int (*Create)(void *, void *, unsigned, const void *, const void *, void *);

static Lookup real, of_device;
static Create create;
static volatile int made, hangs;

static int create_or_hang(void *device, void *cache, unsigned count, const void *infos, const void *allocator, void *pipelines) {
  if (made++ < atoi(getenv("HANGING_AFTER"))) return create(device, cache, count, infos, allocator, pipelines);
  hangs = 1;
  for (;;) pause();
}

static Function device_function(void *device, const char *name) {
  Function function = of_device(device, name);
  if (strcmp(name, "vkCreateComputePipelines") != 0) return function;
  create = (Create)function;
  return (Function)create_or_hang;
}

Function vkGetInstanceProcAddr(void *instance, const char *name) {
  if (!real) real = (Lookup)dlsym(dlopen(getenv("HANGING_REAL"), RTLD_NOW | RTLD_LOCAL), "vkGetInstanceProcAddr");
  Function function = real(instance, name);
  if (!function || strcmp(name, "vkGetDeviceProcAddr") != 0) return function;
  of_device = (Lookup)function;
  return (Function)device_function;
}

__attribute__((destructor)) static void leave(void) {
  while (hangs) pause();
}
