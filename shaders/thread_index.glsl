// Returns an invocation index whose subgroups are consecutive. Vulkan does not define how gl_LocalInvocationIndex maps to subgroups.
uint thread_index() {
    return gl_SubgroupID * uint(DEVICE_SUBGROUP_SIZE) + gl_SubgroupInvocationID;
}
