// The shape of a workgroup that sorts one block: each subgroup takes a range of the block, and its lanes take neighbouring
// keys. Memory order is (subgroup, step, lane), which is also the order of equal keys.
//
// Eight subgroups, or as many of these as 256 invocations and 16 KiB of shared memory allow: see scatter.comp.

#include "blocks.glsl"
#include "digit.glsl"
#include "../thread_index.glsl"

const uint LANES = uint(DEVICE_SUBGROUP_SIZE);
#if DEVICE_SUBGROUP_SIZE <= 32 && DIGIT_BITS <= 9
#define BLOCK_SUBGROUPS 8
#elif DEVICE_SUBGROUP_SIZE <= 64
#define BLOCK_SUBGROUPS 4
#else
#define BLOCK_SUBGROUPS 2
#endif
const uint SUBGROUPS = uint(BLOCK_SUBGROUPS);
const uint THREADS = SUBGROUPS * LANES;
// Steps of a lane through its subgroup's range. A constant, so that keys stay in registers.
const uint STEPS = (uint(BLOCK_KEYS) + THREADS - 1u) / THREADS;

layout(local_size_x = BLOCK_SUBGROUPS * DEVICE_SUBGROUP_SIZE) in;
