// The current digit, and the layout of the counts.

layout(push_constant) uniform Digit {
    uint shift;        // of the digit's lowest bit
    uint mask;         // as wide as the digit; the last one may be narrower than the others
    uint first_total;  // where this digit's totals begin
};

// The total of every bin has TOTAL_PARTS parts, and block b adds to part b mod TOTAL_PARTS. Atomic additions of
// thousands of blocks to one word would be serialised. Serial passes have few blocks, and one part.

uint total_index(uint bin, uint part) {
    return first_total + part * BINS + bin;
}

uint digit_of(uint key) {
    return (key >> shift) & mask;
}
