#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_EXT_control_flow_attributes : require

// Last pass of binning: writes the lists. A workgroup walks a block of splats in the order of their depth, SCATTER_THREADS at a time. The
// pairs of these splats with their bins are dealt to the invocations in order, whatever the number of bins of each. The place of
// a pair in its bin's list is the bin's start, plus the pairs of earlier blocks (from the table), of earlier steps and lower
// subgroups (from the counters, which the subgroups advance in turns), and of lower lanes. So lists are near to far, and the
// same in every run.

#include "../args.glsl"
#include "../groups.glsl"
#include "bins.glsl"
#define SCAN_THREADS SCATTER_THREADS
#include "scan.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Args { uint args[]; };
layout(set = 0, binding = 1, std430) readonly buffer Order { uint order[]; };
layout(set = 0, binding = 2, std430) readonly buffer SortedBins { uint sorted_bins[]; };
layout(set = 0, binding = 3, std430) readonly buffer Table { uint table[]; };
layout(set = 0, binding = 4, std430) readonly buffer Starts { uint starts[]; };
layout(set = 0, binding = 5, std430) writeonly buffer Lists { uint lists[]; };

// The pairs of each bin so far.
shared uint counters[BIN_COUNT];
// The splats of a step: index, bins, and the pairs up to and with this splat.
shared uint step_index[THREADS];
shared uint step_bins[THREADS];
shared uint step_pairs[THREADS];

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
    uint thread = thread_index();
    for (uint bin = thread; bin < uint(BIN_COUNT); bin += THREADS) {
        counters[bin] = 0u;
    }

    uint end = min((block + 1u) * uint(BLOCK_SPLATS), count);
    uint round = 0u;
    uint at = block * uint(BLOCK_SPLATS);
    uint next_bins = at + thread < end ? sorted_bins[at + thread] : 0u;
    uint next_index = at + thread < end ? order[at + thread] : 0u;
    for (; at < end; at += THREADS) {
        bool valid = at + thread < end;
        uint bins = next_bins;
        uint index = next_index;
        // Loaded a step ahead, so that nobody waits for memory.
        bool has_next = at + THREADS + thread < end;
        next_bins = has_next ? sorted_bins[at + THREADS + thread] : 0u;
        next_index = has_next ? order[at + THREADS + thread] : 0u;
        uint pairs = valid ? bins_in(unpack_bins(bins)) : 0u;
        uint total = 0u;
        uint before = exclusive_sum(pairs, round++, total);
        step_index[thread] = index;
        step_bins[thread] = bins;
        step_pairs[thread] = before + pairs;
        barrier();
        for (uint start = 0u; start < total; start += THREADS) {
            uint pair = start + thread;
            bool has_pair = pair < total;
            // The splat of the pair: the first whose pairs go beyond it.
            uint low = 0u;
            [[unroll]] for (uint half_width = THREADS / 2u; half_width > 0u; half_width /= 2u) {
                low += step_pairs[low + half_width - 1u] <= pair ? half_width : 0u;
            }
            uint first = low == 0u ? 0u : step_pairs[low - 1u];
            uint bin = has_pair ? bin_at(step_bins[low], pair - first) : 0u;
            uint begin = has_pair ? starts[bin] + table[bin * blocks + block] : 0u;
            LaneMask peers = peers_of(bin, has_pair);
            uint below = lanes_below(peers);
            uint rank = 0u;
            for (uint turn = 0u; turn < SUBGROUPS; turn++) {
                if (turn == gl_SubgroupID) {
                    rank = counters[bin] + below;
                    subgroupBarrier();  // all lanes read before one of them writes
                    if (has_pair && below == 0u) {
                        counters[bin] += lanes_in(peers);
                    }
                }
                barrier();
            }
            uint place = begin + rank;
            if (has_pair && place < uint(ENTRIES)) {
                lists[place] = step_index[low];
            }
        }
        barrier();
    }
}
