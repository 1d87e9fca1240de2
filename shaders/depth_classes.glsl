// Divides the scene's depth range into classes, for keys equalised over a frame's depths. Classes are equal steps of the
// float's bits, so an outlier adds only a few of them.

const uint CLASSES = 2048u;
const uint CLASS_BITS = 11u;

// Returns a depth's position in the range, scaled by the power of two that lets the range fill 32 bits; depths outside are clamped. Does
// not decrease with z. The upper CLASS_BITS bits are the class.
uint depth_place(float z) {
    float near = camera.depth.y;
#if KEY_OF == KEY_OF_DISTANCE
    float far = max(camera.depth.w, near);
#else
    float far = max(camera.depth.z, near);
#endif
    uint first = floatBitsToUint(near);
    uint range = floatBitsToUint(far) - first;
    uint x = floatBitsToUint(clamp(z, near, far)) - first;
    return range == 0u ? 0u : x << (31u - uint(findMSB(range)));
}
