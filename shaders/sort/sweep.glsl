// The shape of a workgroup of the one-sweep sort, and its buffers. A workgroup takes one block: each subgroup takes a range of the block, and
// its lanes take neighbouring keys. Memory order is (subgroup, step, lane), which is also the order of equal keys.

#include "blocks.glsl"
#include "../thread_index.glsl"

const uint LANES = uint(DEVICE_SUBGROUP_SIZE);
const uint THREADS = uint(SWEEP_THREADS);
const uint SUBGROUPS = THREADS / LANES;
// Steps of a lane through its subgroup's range. A constant, so that keys stay in registers.
const uint STEPS = (uint(BLOCK_KEYS) + THREADS - 1u) / THREADS;

layout(local_size_x = SWEEP_THREADS) in;
