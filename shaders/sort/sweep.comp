#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_memory_scope_semantics : require
#extension GL_EXT_control_flow_attributes : require

// A digit in one dispatch: a workgroup counts the bins of its block of keys, publishes the counts, and sums those of earlier blocks
// ("decoupled look-back", Merrill and Garland 2016). Then it moves every pair to its place.
//
// A workgroup must not wait for another: Vulkan guarantees neither that workgroups begin in the order of their indices, nor that they make
// progress. After POLLS polls without a result, a workgroup counts the predecessor's keys itself ("decoupled fallback", Smith, Levien and
// Owens, SPAA 2025). A word of the table holds a count and its kind, and publishes no other memory, so relaxed atomics of device scope
// suffice.
//
// The place of a key in its block is that of its bin, plus the number of keys of the same bin before it: those of lower subgroups, of
// earlier steps of its own, and of lower lanes in the same step. The order is deterministic, so the sort is stable.

#include "sweep.glsl"
#include "digit.glsl"
#include "peers.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Args { uint args[]; };
layout(set = 0, binding = 1, std430) readonly buffer KeysIn { uint keys_in[]; };
layout(set = 0, binding = 2, std430) readonly buffer ValuesIn { uint values_in[]; };
layout(set = 0, binding = 3, std430) buffer Table { uint table[]; };
layout(set = 0, binding = 4, std430) writeonly buffer NextTable { uint next_table[]; };
#if TICKETS
layout(set = 0, binding = 5, std430) buffer Totals { uint totals[]; };
shared uint ticket;
#else
layout(set = 0, binding = 5, std430) readonly buffer Totals { uint totals[]; };
#endif
layout(set = 0, binding = 6, std430) writeonly buffer KeysOut { uint keys_out[]; };
layout(set = 0, binding = 7, std430) writeonly buffer ValuesOut { uint values_out[]; };

// A word of the table: the count in the upper 30 bits, and its kind.
const uint NOTHING = 0u;
const uint BLOCK_ALONE = 1u;
const uint ALL_BEFORE = 2u;

const uint COUNTERS = SUBGROUPS * BINS;
const uint BINS_PER_THREAD = (BINS + THREADS - 1u) / THREADS;
const uint WINDOW = uint(LOOK_BACK);
const uint PAIRS = (STEPS + 1u) / 2u;

// Used three times: for the counters of each subgroup and bin, then for the block's keys in the order of the digit, then for its values.
shared uint words[max(COUNTERS, STEPS * THREADS)];
// The place of each bin's run, minus its offset in the block.
shared uint bin_place[BINS];
shared uint subgroup_sums[SUBGROUPS];
shared uint stalled;

// Writes half `i` of packed words: the lower half of a word for even `i`, which must come first, and the upper half for odd.
void set_half(inout uint word, uint i, uint half_word) {
    word = i % 2u == 0u ? half_word : word | (half_word << 16);
}

uint half_of(uint word, uint i) {
    return (word >> (16u * (i % 2u))) & 0xffffu;
}

void publish(uint block, uint bin, uint what, uint keys) {
    atomicStore(table[block * BINS + bin], (keys << 2) | what, gl_ScopeDevice, 0, 0);
}

uint published(uint block, uint bin) {
    return atomicLoad(table[block * BINS + bin], gl_ScopeDevice, 0, 0);
}

// Adds to `sum` the counts of a bin that blocks have published, from block `next - 1` down, and lowers `next`. Returns true when all
// earlier blocks are included, false if one of them has not published for POLLS polls.
bool look_back(uint bin, inout uint next, inout uint sum) {
    uint polls = 0u;
    while (next > 0u && polls < uint(POLLS)) {
        uint found[WINDOW];
        [[unroll]] for (uint j = 0u; j < WINDOW; j++) {
            found[j] = j < next ? published(next - 1u - j, bin) : NOTHING;
        }
        uint taken = 0u;
        bool open = true;
        [[unroll]] for (uint j = 0u; j < WINDOW; j++) {
            uint what = found[j] & 3u;
            open = open && what != NOTHING;
            sum += open ? found[j] >> 2 : 0u;
            taken = open ? (what == ALL_BEFORE ? next : taken + 1u) : taken;
            open = open && what != ALL_BEFORE;
        }
        next -= taken;
        polls = taken == 0u ? polls + 1u : 0u;
    }
    return next == 0u;
}

// Sums `value` over lower invocations. Must be called by the whole workgroup.
uint sum_below(uint value) {
    uint inclusive = subgroupInclusiveAdd(value);
    barrier();
    if (gl_SubgroupInvocationID == LANES - 1u) {
        subgroup_sums[gl_SubgroupID] = inclusive;
    }
    barrier();
    uint sum = inclusive - value;
    for (uint s = 0u; s < SUBGROUPS; s++) {
        sum += s < gl_SubgroupID ? subgroup_sums[s] : 0u;
    }
    return sum;
}

// Sums the keys of all lower bins. Must be called by the whole workgroup.
void lower_bins(out uint lower[BINS_PER_THREAD]) {
    uint total[BINS_PER_THREAD];
    uint sum = 0u;
    [[unroll]] for (uint j = 0u; j < BINS_PER_THREAD; j++) {
        uint bin = thread_index() * BINS_PER_THREAD + j;
        total[j] = 0u;
        for (uint part = 0u; part < uint(TOTAL_PARTS) && bin < BINS; part++) {
            total[j] += totals[total_index(bin, part)];
        }
        sum += total[j];
    }
    uint below = sum_below(sum);
    [[unroll]] for (uint j = 0u; j < BINS_PER_THREAD; j++) {
        lower[j] = below;
        below += total[j];
    }
}

void main() {
    uint count = args[ARGS_VISIBLE];
    uint blocks = blocks_of(count);
    uint thread = thread_index();
    uint block = group_index();
#if TICKETS
    if (thread == 0u) {
        ticket = atomicAdd(totals[uint(DIGITS) * BINS * uint(TOTAL_PARTS) + first_total / (BINS * uint(TOTAL_PARTS))], 1u);
    }
    barrier();
    block = ticket;
#endif
    if (block >= blocks) {
        return;
    }
#if STARVE
    // Reverses the blocks, so that predecessors have not published yet.
    block = blocks - 1u - block;
#endif
    uint first = block * uint(BLOCK_KEYS);
    uint held = min(uint(BLOCK_KEYS), count - first);
    uint mine = gl_SubgroupID * (STEPS * LANES) + gl_SubgroupInvocationID;
    uint own = gl_SubgroupID * BINS;

    // Lanes beyond the end hold keys of the highest bin, which come after all others and are not written.
    uint keys[STEPS];
    [[unroll]] for (uint i = 0u; i < STEPS; i++) {
        uint at = mine + i * LANES;
        keys[i] = at < held ? keys_in[first + at] : ~0u;
    }
    if (thread == 0u) {
        stalled = 0u;
    }
    [[unroll]] for (uint i = 0u; i < (COUNTERS + THREADS - 1u) / THREADS; i++) {
        uint at = i * THREADS + thread;
        if (COUNTERS % THREADS == 0u || at < COUNTERS) {
            words[at] = 0u;
        }
    }
    barrier();

    // Each subgroup walks its range and counts; the counter before a key is its rank among those of its bin in the range.
    // Ranks are packed two to a word, to save registers.
    uint ranks[PAIRS];
    [[unroll]] for (uint i = 0u; i < STEPS; i++) {
        uint bin = digit_of(keys[i]);
        LaneMask peers = peers_of(bin);
        uint below = lanes_below(peers);
        uint rank = words[own + bin] + below;
        subgroupBarrier();  // all lanes read before one of them writes
        if (below == 0u) {
            words[own + bin] = rank + bits_in(peers);
        }
        subgroupBarrier();  // the write is complete before the next read
        set_half(ranks[i / 2u], i, rank);
    }
    barrier();

    // For each bin: the keys of the block, published to later blocks at once, and the offset of each subgroup in the block.
    uint in_block[BINS_PER_THREAD];
    uint sum = 0u;
    [[unroll]] for (uint j = 0u; j < BINS_PER_THREAD; j++) {
        uint bin = thread * BINS_PER_THREAD + j;
        in_block[j] = 0u;
        if (bin < BINS) {
            [[unroll]] for (uint s = 0u; s < SUBGROUPS; s++) {
                in_block[j] += words[s * BINS + bin];
            }
            // Lanes beyond the end count for the highest bin.
            in_block[j] -= bin == mask ? STEPS * THREADS - held : 0u;
            if (block > 0u) {
                publish(block, bin, BLOCK_ALONE, in_block[j]);
            }
            next_table[block * BINS + bin] = 0u;
        }
        sum += in_block[j];
    }
    uint start = sum_below(sum);
    uint starts[BINS_PER_THREAD];
    [[unroll]] for (uint j = 0u; j < BINS_PER_THREAD; j++) {
        uint bin = thread * BINS_PER_THREAD + j;
        starts[j] = start;
        if (bin < BINS) {
            // Read again, because registers decide how many workgroups fit on a multiprocessor.
            [[unroll]] for (uint s = 0u; s < SUBGROUPS; s++) {
                uint of_subgroup = words[s * BINS + bin];
                words[s * BINS + bin] = start;
                start += of_subgroup;
            }
        }
    }
    barrier();
    [[unroll]] for (uint i = 0u; i < STEPS; i++) {
        ranks[i / 2u] += words[own + digit_of(keys[i])] << (16u * (i % 2u));
    }
    barrier();  // the keys replace the counters from here on
    [[unroll]] for (uint i = 0u; i < STEPS; i++) {
        words[half_of(ranks[i / 2u], i)] = keys[i];
    }
    uint values[STEPS];
    [[unroll]] for (uint i = 0u; i < STEPS; i++) {
        uint at = mine + i * LANES;
        values[i] = at < held ? values_in[first + at] : 0u;
    }
    // Keys of earlier blocks in the same bin.
    uint next[BINS_PER_THREAD];
    uint before[BINS_PER_THREAD];
    [[unroll]] for (uint j = 0u; j < BINS_PER_THREAD; j++) {
        next[j] = block;
        before[j] = 0u;
    }
    if (block == 0u) {
        lower_bins(before);
    }
    for (;;) {
        [[unroll]] for (uint j = 0u; j < BINS_PER_THREAD; j++) {
            uint bin = thread * BINS_PER_THREAD + j;
            if (bin < BINS && !look_back(bin, next[j], before[j])) {
                atomicMax(stalled, next[j]);
            }
        }
        barrier();
        uint waited_for = stalled;
        barrier();
        if (waited_for == 0u) {
            break;
        }
        // The stalled block may never run, so its keys are counted here.
        for (uint bin = thread; bin < BINS; bin += THREADS) {
            bin_place[bin] = 0u;
        }
        if (thread == 0u) {
            stalled = 0u;
        }
        barrier();
        uint other = (waited_for - 1u) * uint(BLOCK_KEYS);
        for (uint i = thread; i < uint(BLOCK_KEYS); i += THREADS) {
            atomicAdd(bin_place[digit_of(keys_in[other + i])], 1u);
        }
        barrier();
        uint lower[BINS_PER_THREAD];
        [[unroll]] for (uint j = 0u; j < BINS_PER_THREAD; j++) {
            lower[j] = 0u;
        }
        if (waited_for == 1u) {
            lower_bins(lower);
        }
        [[unroll]] for (uint j = 0u; j < BINS_PER_THREAD; j++) {
            uint bin = thread * BINS_PER_THREAD + j;
            if (bin < BINS) {
                uint word = ((lower[j] + bin_place[bin]) << 2) | (waited_for == 1u ? ALL_BEFORE : BLOCK_ALONE);
                atomicCompSwap(table[(waited_for - 1u) * BINS + bin], NOTHING, word);
            }
        }
        barrier();
    }
    [[unroll]] for (uint j = 0u; j < BINS_PER_THREAD; j++) {
        uint bin = thread * BINS_PER_THREAD + j;
        if (bin < BINS) {
            publish(block, bin, ALL_BEFORE, before[j] + in_block[j]);
            bin_place[bin] = before[j] - starts[j];
        }
    }
    barrier();

    uint digits[PAIRS];
    [[unroll]] for (uint i = 0u; i < STEPS; i++) {
        uint at = i * THREADS + thread;
        if (at < held) {
            uint key = words[at];
            uint digit = digit_of(key);
            set_half(digits[i / 2u], i, digit);
            keys_out[bin_place[digit] + at] = key;
        }
    }
    barrier();
    [[unroll]] for (uint i = 0u; i < STEPS; i++) {
        words[half_of(ranks[i / 2u], i)] = values[i];
    }
    barrier();
    [[unroll]] for (uint i = 0u; i < STEPS; i++) {
        uint at = i * THREADS + thread;
        if (at < held) {
            values_out[bin_place[half_of(digits[i / 2u], i)] + at] = words[at];
        }
    }
}
