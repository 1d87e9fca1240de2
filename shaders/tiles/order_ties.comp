#version 460
#extension GL_GOOGLE_include_directive : require

// Last pass of the sort of pairs, if they are sorted once. The radix sort leaves out the lowest bits of the keys, and the bits of the
// depth that do not fit in a key are above the splat's index. Pairs that agree in all sorted bits are adjacent: a *run*. A pair's place in
// its run is the number of the run's pairs that come before it. A run is usually a few pairs long; one of more than RUN stays in no
// particular order, and its pairs are counted. The pass also finds each bin's list.

#include "../args.glsl"
#include "../groups.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, std430) readonly buffer PairArgs { uint pair_args[]; };
layout(set = 0, binding = 1, std430) readonly buffer PairKeys { uint pair_keys[]; };
layout(set = 0, binding = 2, std430) writeonly buffer Ranges { uvec2 ranges[]; };
layout(set = 0, binding = 3, std430) readonly buffer SplatsIn { uint splats_in[]; };
layout(set = 0, binding = 4, std430) writeonly buffer SplatsOut { uint splats_out[]; };
layout(set = 0, binding = 5, std430) buffer Counts { uint counts[]; };

#include "ranges.glsl"

const uint RUN = 128u;
// The pairs of the workgroup, plus the length of a run on either side.
const uint MARGIN = RUN;
const uint WINDOW = 256u + 2u * MARGIN;
shared uint near_keys[WINDOW];
shared uint near_splats[WINDOW];

// Returns the bits ordered by the radix sort.
uint sorted_part(uint key) {
    return key >> TIE_BITS;
}

// Returns the splat of a pair; depth bits may be above its index.
uint splat_of(uint pair) {
#if REST_BITS > 0
    return pair & ((1u << INDEX_BITS) - 1u);
#else
    return pair;
#endif
}

void main() {
    uint count = pair_args[ARGS_VISIBLE];
    uint first = group_index() * gl_WorkGroupSize.x;
    uint thread = gl_LocalInvocationIndex;
    if (first > count) {
        return;
    }
    for (uint w = thread; w < WINDOW; w += gl_WorkGroupSize.x) {
        uint pair = first + w - MARGIN;
        near_keys[w] = pair < count ? pair_keys[pair] : 0u;
        near_splats[w] = pair < count ? splats_in[pair] : 0u;
    }
    barrier();
    uint i = first + thread;
    if (i > count) {
        return;
    }
    uint at = MARGIN + thread;
    uint own = near_keys[at];
    find_ranges(i, count, near_keys[at - 1u] >> HELD_BITS, own >> HELD_BITS);
    if (i == count) {
        return;
    }
    uint part = sorted_part(own);
    uint before = 0u;
    uint most = min(i, RUN);
    while (before < most && sorted_part(near_keys[at - before - 1u]) == part) {
        before++;
    }
    uint after = 0u;
    most = min(count - 1u - i, RUN);
    while (after < most && sorted_part(near_keys[at + after + 1u]) == part) {
        after++;
    }
    uint place = i;
    if (before + after >= RUN) {
        atomicAdd(counts[COUNTS_TIED], 1u);
    } else if (before + after > 0u) {
        // Compares the last bits of the depth, then the index.
        uint own_word = near_splats[at];
        place = i - before;
        for (uint j = 0u; j <= before + after; j++) {
            uint key = near_keys[at - before + j];
            bool comes_first = key < own || (key == own && near_splats[at - before + j] < own_word);
            place += comes_first ? 1u : 0u;
        }
    }
    splats_out[place] = splat_of(near_splats[at]);
}
