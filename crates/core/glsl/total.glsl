// The sum of the partial sums that a dispatch of project.comp has written. Includers declare `partial`.

const uint WORKGROUP = 64;
// Lanes of a dispatch.
const uint LANES = 64 * WORKGROUP;

layout(local_size_x = 64) in;

shared real of_lane[WORKGROUP];

// That of dispatch `before`, on every lane. It is noted for the host behind the two slices of partial sums.
real total(uint before) {
    uint lane = gl_LocalInvocationID.x;
    uint slice = (before & 1) * LANES;
    real sum = 0.0;
    for (uint i = lane; i < LANES; i += WORKGROUP) {
        sum += partial[slice + i];
    }
    of_lane[lane] = sum;
    barrier();
    sum = 0.0;
    for (uint i = 0; i < WORKGROUP; ++i) {
        sum += of_lane[i];
    }
    if (gl_GlobalInvocationID.x == 0) {
        partial[2 * LANES + before] = sum;
    }
    return sum;
}
