// Folds workgroups that exceed the limit in x into y, as groups.glsl reads them: the words of an indirect dispatch. Zero is 0 by 1.
uvec3 fold_groups(uint groups) {
    uint x = min(groups, uint(DEVICE_MAX_GROUPS_X));
    return uvec3(x, x == 0u ? 1u : (groups + x - 1u) / x, 1u);
}
