// Divides the scene's range of depths into classes, for keys that are equalised over the depths of a frame. The classes are equal
// steps of the float's bits, so that an outlier takes some of them and not all.

const uint CLASSES = 2048u;
const uint CLASS_BITS = 11u;

// Returns the place of a depth in the range, as a share of 2^32 that never decreases in z; depths outside are clamped to it. The
// upper CLASS_BITS bits are the class.
uint depth_place(float z) {
    float near = camera.depth.y;
    float far = max(camera.depth.z, near);
    uint first = floatBitsToUint(near);
    uint range = floatBitsToUint(far) - first;
    uint x = floatBitsToUint(clamp(z, near, far)) - first;
    return range == 0u ? 0u : x << (31u - uint(findMSB(range)));
}
