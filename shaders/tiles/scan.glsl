// Scans over a workgroup of SCAN_THREADS invocations.

layout(local_size_x = SCAN_THREADS) in;

const uint THREADS = uint(SCAN_THREADS);
const uint SUBGROUPS = THREADS / uint(DEVICE_SUBGROUP_SIZE);

// Two alternating sets, so that one barrier per round is enough.
shared uint subgroup_sum[2][SUBGROUPS];

// Vulkan does not define the mapping of invocations to subgroups, so indices come from these two values only.
uint thread_index() {
    return gl_SubgroupID * uint(DEVICE_SUBGROUP_SIZE) + gl_SubgroupInvocationID;
}

// Sums `value` over lower threads, and adds the sum over all threads to `carry`. Must be called by the whole workgroup.
uint exclusive_sum(uint value, uint round, inout uint carry) {
    uint inclusive = subgroupInclusiveAdd(value);
    if (gl_SubgroupInvocationID == gl_SubgroupSize - 1u) {
        subgroup_sum[round & 1u][gl_SubgroupID] = inclusive;
    }
    barrier();
    uint sum = carry + inclusive - value;
    for (uint s = 0u; s < SUBGROUPS; s++) {
        uint other = subgroup_sum[round & 1u][s];
        sum += s < gl_SubgroupID ? other : 0u;
        carry += other;
    }
    return sum;
}
