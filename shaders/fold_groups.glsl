// Returns the words of an indirect dispatch. Workgroups beyond the limit in x continue in y; see groups.glsl. 0 gives (0, 1, 1).
uvec3 fold_groups(uint groups) {
    uint x = min(groups, uint(DEVICE_MAX_GROUPS_X));
    return uvec3(x, x == 0u ? 1u : (groups + x - 1u) / x, 1u);
}
