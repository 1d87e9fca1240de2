#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_EXT_control_flow_attributes : require

// Third pass of a digit: moves every pair to its place. A key's place is that of its bin and block (from the table), plus
// the number of keys of the same bin before it in its block: those of lower subgroups, of earlier steps of its own, and of
// lower lanes in the same step. The order is deterministic, so the sort is stable.
//
// If the block fits in shared memory, its pairs are sorted there first. They are then written in runs, one per bin, and
// neighbouring lanes write neighbouring words.

#include "block.glsl"
#include "peers.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Args { uint args[]; };
layout(set = 0, binding = 1, std430) readonly buffer KeysIn { uint keys_in[]; };
layout(set = 0, binding = 2, std430) readonly buffer ValuesIn { uint values_in[]; };
layout(set = 0, binding = 3, std430) readonly buffer Table { uint table[]; };
layout(set = 0, binding = 4, std430) writeonly buffer KeysOut { uint keys_out[]; };
layout(set = 0, binding = 5, std430) writeonly buffer ValuesOut { uint values_out[]; };

// Counters have 16 bits, two in a word; every subgroup has one per bin. For four subgroups and 11 bits that is 16 KiB.
const uint WORDS = BINS / 2u;
const uint COUNTER_WORDS = SUBGROUPS * WORDS;
const uint WORDS_PER_THREAD = (WORDS + THREADS - 1u) / THREADS;

// If 16 KiB hold the block and the bins' places, pairs are sorted in shared memory; otherwise they are scattered directly.
#define REORDER (DIGIT_BITS <= 10 && 4 * BLOCK_KEYS + (4 << DIGIT_BITS) <= 16384)

#if REORDER
// Used three times: for the counters followed by the subgroups' sums, then for the block's keys, then for its values.
shared uint words[max(COUNTER_WORDS + SUBGROUPS, uint(BLOCK_KEYS))];
// The place of each bin's run, minus its offset in the block.
shared uint bin_place[BINS];
#else
shared uint words[COUNTER_WORDS];
#endif

uint counter(uint subgroup, uint bin) {
    return (words[subgroup * WORDS + (bin >> 1)] >> (16u * (bin & 1u))) & 0xffffu;
}

void main() {
    uint count = args[ARGS_VISIBLE];
    uint blocks = blocks_of(count);
    uint block = group_index();
    if (block >= blocks) {
        return;
    }
    uint thread = thread_index();
    uint first = block * uint(BLOCK_KEYS);
    uint end = min(first + uint(BLOCK_KEYS), count);
    uint mine = first + gl_SubgroupID * (STEPS * LANES) + gl_SubgroupInvocationID;

    uint keys[STEPS];
    [[unroll]] for (uint i = 0u; i < STEPS; i++) {
        uint at = mine + i * LANES;
        keys[i] = at < end ? keys_in[at] : 0u;
    }
    for (uint w = thread; w < COUNTER_WORDS; w += THREADS) {
        words[w] = 0u;
    }
#if REORDER
    for (uint bin = thread; bin < BINS; bin += THREADS) {
        bin_place[bin] = table[bin * blocks + block];
    }
#endif
    barrier();

    // Each subgroup walks its range and counts; the counter before a key is its rank among those of its bin in the range.
    // Lanes beyond the end take part in the ballots, but match no lane.
    uint rank[STEPS];
    [[unroll]] for (uint i = 0u; i < STEPS; i++) {
        bool valid = mine + i * LANES < end;
        uint bin = digit_of(keys[i]);
        LaneMask peers = peers_of(bin, valid);
        uint below = lanes_below(peers);
        rank[i] = counter(gl_SubgroupID, bin) + below;
        subgroupBarrier();  // all lanes read before one of them writes
        if (valid && below == 0u) {
            // Atomic, because another bin's counter shares the word.
            atomicAdd(words[gl_SubgroupID * WORDS + (bin >> 1)], bits_in(peers) << (16u * (bin & 1u)));
        }
        subgroupBarrier();  // the write is complete before the next read
    }
#if REORDER
    uint values[STEPS];
    [[unroll]] for (uint i = 0u; i < STEPS; i++) {
        uint at = mine + i * LANES;
        values[i] = at < end ? values_in[at] : 0u;
    }
#endif
    barrier();

    // Turns counts into offsets of each subgroup within its bin, for both halves of a word at once: a block has fewer than
    // 2^16 keys, so no half overflows into the other.
#if REORDER
    uint pair_count[WORDS_PER_THREAD];
    uint sum = 0u;
#endif
    [[unroll]] for (uint j = 0u; j < WORDS_PER_THREAD; j++) {
        uint w = thread * WORDS_PER_THREAD + j;
        uint both = 0u;
        if (w < WORDS) {
            for (uint s = 0u; s < SUBGROUPS; s++) {
                uint here = words[s * WORDS + w];
                words[s * WORDS + w] = both;
                both += here;
            }
        }
#if REORDER
        pair_count[j] = both;
        sum += (both & 0xffffu) + (both >> 16);
#endif
    }

#if REORDER
    // Adds the offset of each bin within the block.
    uint inclusive = subgroupInclusiveAdd(sum);
    if (gl_SubgroupInvocationID == LANES - 1u) {
        words[COUNTER_WORDS + gl_SubgroupID] = inclusive;
    }
    barrier();
    uint start = inclusive - sum;
    for (uint s = 0u; s < SUBGROUPS; s++) {
        start += s < gl_SubgroupID ? words[COUNTER_WORDS + s] : 0u;
    }
    [[unroll]] for (uint j = 0u; j < WORDS_PER_THREAD; j++) {
        uint w = thread * WORDS_PER_THREAD + j;
        uint next = start + (pair_count[j] & 0xffffu);
        if (w < WORDS) {
            for (uint s = 0u; s < SUBGROUPS; s++) {
                words[s * WORDS + w] += start | (next << 16);
            }
            bin_place[2u * w] -= start;
            bin_place[2u * w + 1u] -= next;
        }
        start = next + (pair_count[j] >> 16);
    }
    barrier();

    [[unroll]] for (uint i = 0u; i < STEPS; i++) {
        rank[i] += counter(gl_SubgroupID, digit_of(keys[i]));
    }
    barrier();  // the keys replace the counters from here on

    [[unroll]] for (uint i = 0u; i < STEPS; i++) {
        if (mine + i * LANES < end) {
            words[rank[i]] = keys[i];
        }
    }
    barrier();
    uint place[STEPS];
    [[unroll]] for (uint i = 0u; i < STEPS; i++) {
        uint at = i * THREADS + thread;
        if (first + at < end) {
            uint key = words[at];
            place[i] = bin_place[digit_of(key)] + at;
            keys_out[place[i]] = key;
        }
    }
    barrier();
    [[unroll]] for (uint i = 0u; i < STEPS; i++) {
        if (mine + i * LANES < end) {
            words[rank[i]] = values[i];
        }
    }
    barrier();
    [[unroll]] for (uint i = 0u; i < STEPS; i++) {
        uint at = i * THREADS + thread;
        if (first + at < end) {
            values_out[place[i]] = words[at];
        }
    }
#else
    barrier();
    [[unroll]] for (uint i = 0u; i < STEPS; i++) {
        uint at = mine + i * LANES;
        if (at < end) {
            uint bin = digit_of(keys[i]);
            uint place = table[bin * blocks + block] + counter(gl_SubgroupID, bin) + rank[i];
            keys_out[place] = keys[i];
            values_out[place] = values_in[at];
        }
    }
#endif
}
