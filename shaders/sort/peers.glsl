// Finds the lanes of the subgroup with the same digit: one ballot per bit of the digit, keeping the lanes with an equal
// bit. A mask has as many words as the subgroup needs. Must be called by whole subgroups.

#if DEVICE_SUBGROUP_SIZE <= 32
#define LaneMask uint
#define MASK_OF(ballot) (ballot).x
#elif DEVICE_SUBGROUP_SIZE <= 64
#define LaneMask uvec2
#define MASK_OF(ballot) (ballot).xy
#else
#define LaneMask uvec4
#define MASK_OF(ballot) (ballot)
#endif

uint bits_in(uint mask) {
    return uint(bitCount(mask));
}

uint bits_in(uvec2 mask) {
    return bits_in(mask.x) + bits_in(mask.y);
}

uint bits_in(uvec4 mask) {
    return bits_in(mask.xy) + bits_in(mask.zw);
}

// Returns the lanes with this lane's `bin`.
LaneMask peers_of(uint bin) {
    LaneMask peers = MASK_OF(subgroupBallot(true));
    [[unroll]] for (uint b = 0u; b < uint(DIGIT_BITS); b++) {
        bool one = (bin & (1u << b)) != 0u;
        LaneMask ones = MASK_OF(subgroupBallot(one));
        peers &= one ? ones : ~ones;
    }
    return peers;
}

// Returns the valid lanes with this lane's `bin`; undefined for an invalid lane. The loop differs from the one
// above: scatter.comp has measured faster with this form, and sweep.comp with the other.
LaneMask peers_of(uint bin, bool valid) {
    LaneMask peers = MASK_OF(subgroupBallot(valid));
    [[unroll]] for (uint b = 0u; b < uint(DIGIT_BITS); b++) {
        uint bit = (bin >> b) & 1u;
        LaneMask ones = MASK_OF(subgroupBallot(bit != 0u));
        peers &= ones ^ LaneMask(bit - 1u);
    }
    return peers;
}

uint lanes_below(LaneMask mask) {
    return bits_in(mask & MASK_OF(gl_SubgroupLtMask));
}
