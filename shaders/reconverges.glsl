// Defines RECONVERGES, an attribute of `main`: lanes that left a subgroup's uniform branch or loop one by one are together after it. Without
// the device's promise, drivers are relied on. Include this before everything else.

#if DEVICE_SUBGROUP_UNIFORM_CONTROL_FLOW
#extension GL_EXT_subgroup_uniform_control_flow : require
#define RECONVERGES [[subgroup_uniform_control_flow]]
#else
#define RECONVERGES
#endif
