// Projects a splat per invocation. Counts the visible ones of each workgroup, so that compact.comp can close the gaps in index order.
// The including file defines `float project(uint i)`, which returns the depth that orders splat `i`, or -1 if it is invisible, and
// `void leave_out(uint i)` for invisible splats.

layout(local_size_x = 256) in;

layout(set = 0, binding = 4, std430) writeonly buffer Depth { float depth_of[]; };
layout(set = 0, binding = 5, std430) writeonly buffer BlockCount { uint block_count[]; };

// The number of visible splats in the workgroup, counted without ballots: invocations return from `project` at different
// places, and reconvergence is not guaranteed.
shared uint visible_count;

void project_all() {
    uint group = group_index();
    uint i = group * gl_WorkGroupSize.x + gl_LocalInvocationIndex;
    if (gl_LocalInvocationIndex == 0u) {
        visible_count = 0u;
    }
    barrier();

    float z = -1.0;
    if (i < uint(SCENE_COUNT)) {
        z = project(i);
        depth_of[i] = z;
        if (!(z > 0.0)) {
            leave_out(i);
        }
    }
    if (z > 0.0) {
        atomicAdd(visible_count, 1u);
    }
    barrier();
    if (gl_LocalInvocationIndex == 0u && group * gl_WorkGroupSize.x < uint(SCENE_COUNT)) {
        block_count[group] = visible_count;
    }
}
