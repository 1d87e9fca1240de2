// Evaluates view-dependent colour: real spherical harmonics up to degree SH_DEGREE, in the basis and the sign convention
// of 3D Gaussian Splatting. The coefficients are in planes of four floats per splat; float 3 k + c of a splat is channel c
// of coefficient k, so four coefficients fill three planes.
//
// Source of the basis: Sloan, "Efficient Spherical Harmonic Evaluation", JCGT 2013; signs as in Kerbl et al. 2023.

layout(set = 0, binding = 8, std430) readonly buffer Sh { vec4 v[]; } sh[SH_PLANES];

// Evaluates the colour of splat `i` along `d`, a unit vector from the camera to the splat. At least 0, without a maximum.
vec3 sh_colour(uint i, vec3 d) {
    vec4 a = sh[0].v[i];
    vec3 colour = 0.28209479177387814 * a.xyz;
#if SH_DEGREE >= 1
    float x = d.x, y = d.y, z = d.z;
    vec4 b = sh[1].v[i];
    vec4 c = sh[2].v[i];
    const float C1 = 0.4886025119029199;
    colour += C1 * (z * vec3(b.zw, c.x) - y * vec3(a.w, b.xy) - x * c.yzw);
#endif
#if SH_DEGREE >= 2
    float xx = x * x, yy = y * y, zz = z * z;
    a = sh[3].v[i];
    b = sh[4].v[i];
    c = sh[5].v[i];
    colour += 1.0925484305920792 * (x * y) * a.xyz
        - 1.0925484305920792 * (y * z) * vec3(a.w, b.xy)
        + 0.31539156525252005 * (2.0 * zz - xx - yy) * vec3(b.zw, c.x)
        - 1.0925484305920792 * (x * z) * c.yzw;
    a = sh[6].v[i];
    colour += 0.5462742152960396 * (xx - yy) * a.xyz;
#endif
#if SH_DEGREE >= 3
    b = sh[7].v[i];
    c = sh[8].v[i];
    colour += -0.5900435899266435 * (y * (3.0 * xx - yy)) * vec3(a.w, b.xy)
        + 2.890611442640554 * (x * y * z) * vec3(b.zw, c.x)
        - 0.4570457994644658 * (y * (4.0 * zz - xx - yy)) * c.yzw;
    a = sh[9].v[i];
    b = sh[10].v[i];
    c = sh[11].v[i];
    colour += 0.3731763325901154 * (z * (2.0 * zz - 3.0 * xx - 3.0 * yy)) * a.xyz
        - 0.4570457994644658 * (x * (4.0 * zz - xx - yy)) * vec3(a.w, b.xy)
        + 1.445305721320277 * (z * (xx - yy)) * vec3(b.zw, c.x)
        - 0.5900435899266435 * (x * (xx - 3.0 * yy)) * c.yzw;
#endif
    return max(colour + 0.5, vec3(0.0));
}
