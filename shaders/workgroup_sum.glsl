// Sums over a workgroup of SUBGROUPS whole subgroups, a constant that the including file defines.

// Two alternating sets, so that one barrier per round is enough.
shared uint subgroup_sum[2][SUBGROUPS];

// Returns `carry` plus the sum of `value` over lower invocations, and adds the sum over all invocations to `carry`. Must be called by
// the whole workgroup, with a `round` that increases by 1 from call to call.
uint exclusive_sum(uint value, uint round, inout uint carry) {
    uint inclusive = subgroupInclusiveAdd(value);
    if (gl_SubgroupInvocationID == gl_SubgroupSize - 1u) {
        subgroup_sum[round & 1u][gl_SubgroupID] = inclusive;
    }
    barrier();
    // Lanes add up the subgroups' sums in parallel: a serial loop takes longer than two more subgroup operations.
    uint lower = 0u;
    uint all = 0u;
    for (uint s = gl_SubgroupInvocationID; s < SUBGROUPS; s += gl_SubgroupSize) {
        uint other = subgroup_sum[round & 1u][s];
        lower += s < gl_SubgroupID ? other : 0u;
        all += other;
    }
    uint sum = carry + subgroupAdd(lower) + inclusive - value;
    carry += subgroupAdd(all);
    return sum;
}
