// Workgroups that do not fit in x are folded into y. Whoever asks for the index must ignore what is beyond the end.
uint group_index() {
    return gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x;
}
