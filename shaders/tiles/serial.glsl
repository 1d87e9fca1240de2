// The shape of the serial tiles, for devices on which lanes communicate slowly and barriers cost more than the work, above all
// CPUs. No invocation waits for another: a workgroup is one subgroup, and relies on the cache instead of shared memory.
//
// The pairs of a splat and a bin, in the order of depth and within a splat row by row, are cut into blocks of equal length, one per
// invocation. So an invocation's work is bounded whatever the splats' sizes: lavapipe ends its loops after 65,535 iterations in all.

#include "serial_lanes.glsl"
#include "bins.glsl"

// The layout of the buffer `work`: the amounts to bin.
//
//   word  byte
//      0     0   workgroups of the passes over pairs: x, y, z (an indirect dispatch)
//      3    12   pairs of a block
//      4    16   blocks of pairs
//      5    20   pairs
const uint WORK_GROUPS = 0u;
const uint WORK_BLOCK_PAIRS = 3u;
const uint WORK_BLOCKS = 4u;
const uint WORK_PAIRS = 5u;
