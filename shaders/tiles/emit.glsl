// Writes the pairs of a block's splats and their bins. The including file defines THREADS and BLOCK, the splats of a block.

layout(set = 0, binding = 10, std430) writeonly buffer PairKeys { uint pair_keys[]; };
layout(set = 0, binding = 11, std430) writeonly buffer PairSplats { uint pair_splats[]; };

// For each splat of the block: the number of pairs up to and including its own; its bins; and the key of its depth, or its index if
// splats are sorted.
shared uint splat_ends[BLOCK];
shared uint splat_bins[BLOCK];
shared uint splat_word[BLOCK];
#ifdef HAS_PLANE
// Centre, in pixels, and the plane of the depth (projection.glsl).
shared vec2 splat_centre[BLOCK];
shared vec3 splat_plane[BLOCK];

// Returns the depth of a splat of the block in a bin: at the pixel that is nearest to its centre.
float depth_in_bin(uint at, uint bin) {
    vec2 origin = vec2(uvec2(bin % uint(BINS_X), bin / uint(BINS_X)) * BIN_SIZE);
    vec2 centre = splat_centre[at];
#if WRAPS
    const float ROUND = float(VIEWPORT_WIDTH);
    centre.x += ROUND * floor((origin.x + 0.5 * float(BIN) - centre.x) / ROUND + 0.5);
#endif
    return splat_plane[at].x + dot(splat_plane[at].yz, clamp(centre, origin, origin + vec2(BIN_SIZE - 1u)) - centre);
}
#endif

#if !SORTS_SPLATS
// Writes a pair at `place`: the bin, with as many bits of the depth's key as fit below it, and the splat, with further bits of the key
// above its index. A sort of the pairs then makes a list for each bin, near to far.
void write_pair(uint place, uint bin, uint key, uint splat) {
    pair_keys[place] = (bin << HELD_BITS) | (key >> (KEY_BITS - HELD_BITS));
#if REST_BITS > 0
    uint rest = (key >> (KEY_BITS - HELD_BITS - REST_BITS)) & ((1u << REST_BITS) - 1u);
    splat |= rest << INDEX_BITS;
#endif
    pair_splats[place] = splat;
}
#endif

// Writes the block's `total` pairs, from place `start`. Invocations take equal shares of them, however many bins a splat touches.
void write_pairs(uint start, uint total) {
    for (uint pair = thread_index(); pair < total; pair += THREADS) {
        // The splat of the pair: the first whose end exceeds the pair's number.
        uint at = 0u;
        [[unroll]] for (uint half_width = BLOCK / 2u; half_width > 0u; half_width /= 2u) {
            at += splat_ends[at + half_width - 1u] <= pair ? half_width : 0u;
        }
        uint within = pair - (at == 0u ? 0u : splat_ends[at - 1u]);
        BinRect r = unpack_bins(splat_bins[at]);
        uint width = r.last.x - r.first.x + 1u;
        uint row = within / width;
        uint bin = (r.first.y + row) * uint(BINS_X) + BIN_COLUMN(r.first.x + within - row * width);
        uint place = start + pair;
        if (place < uint(ENTRIES)) {
#if SORTS_SPLATS
            pair_keys[place] = bin;
            pair_splats[place] = splat_word[at];
#else
#ifdef HAS_PLANE
            uint key = depth_key(depth_in_bin(at, bin));
#else
            uint key = splat_word[at];
#endif
            write_pair(place, bin, key, group_index() * BLOCK + at);
#endif
        }
    }
}
