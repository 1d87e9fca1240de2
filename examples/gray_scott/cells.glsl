// Each invocation takes one cell. Workgroups beyond the device's limit in x are folded into y.
uint cell_index() {
    return (gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x) * gl_WorkGroupSize.x + gl_LocalInvocationIndex;
}
