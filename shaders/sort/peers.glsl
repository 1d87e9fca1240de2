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
    LaneMask peers = LaneMask(~0u);
    [[unroll]] for (uint b = 0u; b < uint(DIGIT_BITS); b++) {
#if PEER_FORM == 0
        uint bit = (bin >> b) & 1u;
        LaneMask ones = MASK_OF(subgroupBallot(bit != 0u));
        peers &= ones ^ LaneMask(bit - 1u);
#elif PEER_FORM == 1
        bool one = (bin & (1u << b)) != 0u;
        LaneMask ones = MASK_OF(subgroupBallot(one));
        peers &= one ? ones : ~ones;
#elif PEER_FORM == 2
        uint m = uint(bitfieldExtract(int(bin), int(b), 1));
        LaneMask ones = MASK_OF(subgroupBallot(m != 0u));
        peers &= ~(ones ^ LaneMask(m));
#elif PEER_FORM == 3
        uint bit = (bin >> b) & 1u;
        LaneMask ones = MASK_OF(subgroupBallot(bit != 0u));
        LaneMask m = LaneMask(bit - 1u);
        peers = peers & (ones ^ m);
#elif PEER_FORM == 4
        uint m = uint(int(bin << (31u - b)) >> 31);
        LaneMask ones = MASK_OF(subgroupBallot(int(m) < 0));
        peers &= ~(ones ^ LaneMask(m));
#elif PEER_FORM == 5
        bool one = (bin & (1u << b)) != 0u;
        LaneMask ones = MASK_OF(subgroupBallot(one));
        if (!one) ones = ~ones;
        peers &= ones;
#endif
    }
    return peers;
}

// Returns the valid lanes with this lane's `bin`; undefined for a lane that is not valid.
LaneMask peers_of(uint bin, bool valid) {
    return peers_of(bin) & MASK_OF(subgroupBallot(valid));
}

uint lanes_in(LaneMask mask) {
    return bits_in(mask);
}

uint lanes_below(LaneMask mask) {
    return bits_in(mask & MASK_OF(gl_SubgroupLtMask));
}

uint lowest_lane(uint mask) {
    return uint(findLSB(mask));
}

uint lowest_lane(uvec2 mask) {
    return mask.x != 0u ? lowest_lane(mask.x) : 32u + lowest_lane(mask.y);
}

uint lowest_lane(uvec4 mask) {
    return any(notEqual(mask.xy, uvec2(0u))) ? lowest_lane(mask.xy) : 64u + lowest_lane(mask.zw);
}
