// Definitions shared by all passes of the radix sort.
//
// A *block* is BLOCK_KEYS consecutive keys. The number of blocks follows from the number of keys, which only the GPU knows.

#include "../args.glsl"
#include "../groups.glsl"

const uint BINS = 1u << DIGIT_BITS;

uint blocks_of(uint keys) {
    return (keys + uint(BLOCK_KEYS) - 1u) / uint(BLOCK_KEYS);
}
