// Sums over a workgroup of SUBGROUPS whole subgroups, a constant that the including file defines.

// Two alternating sets, so that one barrier per round is enough.
shared uint subgroup_sum[2][SUBGROUPS];

// Sums `value` over lower invocations, and adds the sum over all to `carry`. Must be called by the whole workgroup, in rounds that
// count up.
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
