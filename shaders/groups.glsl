// Returns the index of the workgroup. Workgroups beyond the limit in x continue in y; the caller ignores indices beyond
// the end.
#ifndef GROUPS_GLSL
#define GROUPS_GLSL
uint group_index() {
    return gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x;
}
#endif
