// The record of a projected splat, written by tiles/project.comp and read by the rasterisers.
//
// Its falloff is a triangular square root of the inverse covariance: with d the vector from the centre in pixels,
// alpha = exp2(log_alpha - u^2 - v^2), u = root.x d.x + root.y d.y, v = root.z d.y. A sum of squares is subtracted, so
// rounding never raises alpha above the opacity. The factor log2(e) / 2 is part of the root.

struct Record {
    vec2 centre;      // in pixels, pixel centres at integers
    vec3 root;
    float log_alpha;  // log2 of the opacity
    float radius;     // of the square of tiles that the splat may touch, in pixels; 0 without this rule
    vec3 colour;      // display-encoded, not below 0
};

#if RECORD == RECORD_F32
struct StoredRecord { vec4 centre_root; vec4 rest; vec4 colour; };

StoredRecord pack_record(Record r) {
    return StoredRecord(vec4(r.centre, r.root.xy), vec4(r.root.z, r.log_alpha, r.radius, 0.0), vec4(r.colour, 0.0));
}

Record unpack_record(StoredRecord s) {
    return Record(s.centre_root.xy, vec3(s.centre_root.zw, s.rest.x), s.rest.y, s.rest.z, s.colour.rgb);
}
#else
struct StoredRecord { vec4 centre_root; uvec4 rest; };

// Packs a record. Colours become half floats, the radius an integer; one above 16 bits is treated as unbounded.
StoredRecord pack_record(Record r) {
    uint blue = packHalf2x16(vec2(r.colour.b, 0.0));
    return StoredRecord(vec4(r.centre, r.root.xy), uvec4(floatBitsToUint(vec2(r.root.z, r.log_alpha)), packHalf2x16(r.colour.rg),
                                                         blue | (uint(min(r.radius, 65535.0)) << 16)));
}

Record unpack_record(StoredRecord s) {
    vec3 colour = vec3(unpackHalf2x16(s.rest.z), unpackHalf2x16(s.rest.w & 0xffffu).x);
    uint radius = s.rest.w >> 16;
    vec2 rest = uintBitsToFloat(s.rest.xy);
    return Record(s.centre_root.xy, vec3(s.centre_root.zw, rest.x), rest.y, radius == 65535u ? 1e30 : float(radius), colour);
}
#endif

#if WRAPS
// Moves a splat of a panorama by multiples of the picture's width, to its copy nearest to column `x`.
Record copy_near(Record r, float x) {
    const float ROUND = float(VIEWPORT_WIDTH);
    r.centre.x += ROUND * floor((x - r.centre.x) / ROUND + 0.5);
    return r;
}
#define COPY_NEAR(r, x) copy_near(r, x)
#else
#define COPY_NEAR(r, x) (r)
#endif

// The light of a segment at a pixel: the colour that it adds, and its transmittance.
#if RECORD == RECORD_F32
#define StoredSum vec4

vec4 pack_sum(vec4 sum) {
    return sum;
}

vec4 unpack_sum(vec4 sum) {
    return sum;
}
#else
#define StoredSum uvec2

uvec2 pack_sum(vec4 sum) {
    return uvec2(packHalf2x16(sum.rg), packHalf2x16(sum.ba));
}

vec4 unpack_sum(uvec2 sum) {
    return vec4(unpackHalf2x16(sum.x), unpackHalf2x16(sum.y));
}
#endif
