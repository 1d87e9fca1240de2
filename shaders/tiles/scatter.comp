#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_memory_scope_semantics : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_EXT_control_flow_attributes : require

// Last pass of binning: writes the lists. A block of splats in the order of their depth is divided among the subgroups of a
// workgroup, and each walks its range a few splats at a time. The pairs of these splats with their bins are dealt to the lanes in
// order, whatever the number of bins of each. The place of a pair in its bin's list is the bin's start, plus the pairs of earlier
// blocks (from the table), of lower subgroups, of earlier steps, and of lower lanes in the same step. So lists are near to far,
// and the same in every run.

#include "../args.glsl"
#include "../groups.glsl"
#include "bins.glsl"

#define LANES DEVICE_SUBGROUP_SIZE
const uint SUBGROUPS = uint(SCATTER_SUBGROUPS);
const uint THREADS = SUBGROUPS * uint(LANES);
layout(local_size_x = SCATTER_SUBGROUPS * LANES) in;

layout(set = 0, binding = 0, std430) readonly buffer Args { uint args[]; };
layout(set = 0, binding = 1, std430) readonly buffer Order { uint order[]; };
layout(set = 0, binding = 2, std430) readonly buffer SortedBins { uint sorted_bins[]; };
layout(set = 0, binding = 3, std430) readonly buffer Table { uint table[]; };
layout(set = 0, binding = 4, std430) readonly buffer Starts { uint starts[]; };
layout(set = 0, binding = 5, std430) writeonly buffer Lists { uint lists[]; };

// Counters have 16 bits, two in a word; every subgroup has one per bin.
const uint WORDS = (uint(BIN_COUNT) + 1u) / 2u;
shared uint words[SUBGROUPS * WORDS];

// The splats of each subgroup's step: index, bins, and the pairs up to and with this splat.
shared uint step_index[THREADS];
shared uint step_bins[THREADS];
shared uint step_pairs[THREADS];

// Splats of a step: fewer than lanes, as some have several bins, so that the pairs mostly fill the lanes once.
const uint STEP = max(uint(LANES) * 3u / 4u, 1u);

#define PEER_BITS BIN_BITS
#include "../sort/peers.glsl"

uint bin_at(uint bins, uint pair) {
    BinRect r = unpack_bins(bins);
    uint width = r.last.x - r.first.x + 1u;
    return min((r.first.y + pair / width) * uint(BINS_X) + r.first.x + pair % width, uint(BIN_COUNT) - 1u);
}

void main() {
    uint count = args[ARGS_DRAWN];
    uint blocks = (count + uint(BLOCK_SPLATS) - 1u) / uint(BLOCK_SPLATS);
    uint block = group_index();
    if (block >= blocks) {
        return;
    }
    uint lane = gl_SubgroupInvocationID;
    uint own = gl_SubgroupID * uint(LANES);
    uint thread = own + lane;
    const uint RANGE = (uint(BLOCK_SPLATS) + SUBGROUPS - 1u) / SUBGROUPS;
    uint first = block * uint(BLOCK_SPLATS) + gl_SubgroupID * RANGE;
    uint end = min(min(first + RANGE, (block + 1u) * uint(BLOCK_SPLATS)), count);

    for (uint w = thread; w < SUBGROUPS * WORDS; w += THREADS) {
        words[w] = 0u;
    }
    barrier();

    // Each subgroup counts the pairs of its range.
    for (uint at = first + lane; at < end; at += uint(LANES)) {
        BinRect r = unpack_bins(sorted_bins[at]);
        for (uint y = r.first.y; y <= r.last.y; y++) {
            for (uint x = r.first.x; x <= r.last.x; x++) {
                uint bin = min(y * uint(BINS_X) + x, uint(BIN_COUNT) - 1u);
                atomicAdd(words[gl_SubgroupID * WORDS + (bin >> 1)], 1u << (16u * (bin & 1u)));
            }
        }
    }
    barrier();

    // Counts become offsets of each subgroup within the block, both halves of a word at once: a block has fewer than 2^16
    // splats, so no half overflows into the other.
    for (uint w = thread; w < WORDS; w += THREADS) {
        uint both = 0u;
        for (uint s = 0u; s < SUBGROUPS; s++) {
            uint here = words[s * WORDS + w];
            words[s * WORDS + w] = both;
            both += here;
        }
    }
    barrier();

    // Loaded a step ahead, so that nobody waits for memory.
    bool has_next = lane < STEP && first + lane < end;
    uint next_bins = has_next ? sorted_bins[first + lane] : 0u;
    uint next_index = has_next ? order[first + lane] : 0u;
    for (uint at = first; at < end; at += STEP) {
        uint bins = next_bins;
        uint pairs = has_next ? bins_in(unpack_bins(bins)) : 0u;
        uint up_to = subgroupInclusiveAdd(pairs);
        uint total = subgroupMax(up_to);
        step_index[thread] = next_index;
        step_bins[thread] = bins;
        step_pairs[thread] = up_to;
        has_next = lane < STEP && at + STEP + lane < end;
        next_bins = has_next ? sorted_bins[at + STEP + lane] : 0u;
        next_index = has_next ? order[at + STEP + lane] : 0u;
        shared_barrier();
        for (uint start = 0u; start < total; start += uint(LANES)) {
            uint pair = start + lane;
            bool has_pair = pair < total;
            // The splat of the pair: the first whose pairs go beyond it.
            uint low = 0u;
            [[unroll]] for (uint half_width = uint(LANES) / 2u; half_width > 0u; half_width /= 2u) {
                low += step_pairs[own + low + half_width - 1u] <= pair ? half_width : 0u;
            }
            uint before = low == 0u ? 0u : step_pairs[own + low - 1u];
            uint bin = has_pair ? bin_at(step_bins[own + low], pair - before) : 0u;
            uint begin = has_pair ? starts[bin] + table[bin * blocks + block] : 0u;
            LaneMask peers = peers_of(bin, has_pair);
            uint below = lanes_below(peers);
            uint word = gl_SubgroupID * WORDS + (bin >> 1);
            uint shift = 16u * (bin & 1u);
            uint place = begin + ((words[word] >> shift) & 0xffffu) + below;
            shared_barrier();  // all lanes read before one of them writes
            if (has_pair && below == 0u) {
                // Atomic, because another bin's counter shares the word.
                atomicAdd(words[word], lanes_in(peers) << shift);
            }
            if (has_pair && place < uint(ENTRIES)) {
                lists[place] = step_index[own + low];
            }
            shared_barrier();  // the write is complete before the next read
        }
    }
}
