// Vulkan does not define the mapping of invocations to subgroups, so the index of an invocation comes from these two values only.
uint thread_index() {
    return gl_SubgroupID * uint(DEVICE_SUBGROUP_SIZE) + gl_SubgroupInvocationID;
}
