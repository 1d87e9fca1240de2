// What all passes of the radix sort share: the sizes, the digit that is being sorted by, and the layout of the counts.
//
// A *block* is BLOCK_KEYS keys that stand next to each other. The number of blocks follows from the number of keys, which
// only the GPU knows.

#include "../args.glsl"
#include "../groups.glsl"

const uint BINS = 1u << DIGIT_BITS;

layout(push_constant) uniform Digit {
    uint shift;        // of the digit's lowest bit
    uint mask;         // as wide as the digit; the last one may be narrower than the others
    uint first_total;  // where this digit's totals begin
};

// Every bin has its total in TOTAL_PARTS parts, and block b adds to part b mod TOTAL_PARTS: thousands of blocks that add to
// one word would wait for each other.

uint total_index(uint bin, uint part) {
    return first_total + part * BINS + bin;
}

uint digit_of(uint key) {
    return (key >> shift) & mask;
}

uint blocks_of(uint keys) {
    return (keys + uint(BLOCK_KEYS) - 1u) / uint(BLOCK_KEYS);
}
