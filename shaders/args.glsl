// The layout of the buffer `args`: the amounts to sort and to draw, written and read by the GPU.
//
//   word  byte
//      0     0   workgroups of the sort's block passes: x, y, z (an indirect dispatch)
//      3    12   visible splats, which is the number of keys to sort
//      4    16   an indirect draw: vertices, instances, first vertex, first instance
//      8    32   splats drawn: the nearest `ceil(budget * visible)`
//
// The buffer `pair_args` of tile_bins.ron has words 0 to 6 for pairs of a splat and a bin: in word 3 the pairs to sort, in words 4 to 6 the
// workgroups of the pass over them.
#ifndef ARGS_GLSL
#define ARGS_GLSL
const uint ARGS_SORT_GROUPS = 0u;
const uint ARGS_VISIBLE = 3u;
const uint ARGS_DRAW = 4u;
const uint ARGS_DRAWN = 8u;

// The buffer `pair_counts` of tile_splats.ron: the pairs that the frame needs, modulo 2^32; 1 if that sum wrapped; the visible splats.
const uint COUNTED_PAIRS = 0u;
const uint COUNTED_WRAPPED = 1u;
const uint COUNTED_VISIBLE = 2u;

// The buffer `counts` of tile_bins.ron, the frame's statistics: the visible splats; the splats drawn; the pairs that the frame needs; the
// tied pairs that order_ties.comp could not order.
const uint COUNTS_VISIBLE = 0u;
const uint COUNTS_DRAWN = 1u;
const uint COUNTS_NEEDED = 2u;
const uint COUNTS_TIED = 3u;
#endif
