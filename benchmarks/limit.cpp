// What a processor with AVX2 allows: the work of RayCaster and BeamModel by hand, without their guarantees.
//
// Rays of a fan jump over the caster's own table of free rectangles in float32, 8 to a register and 32 under way, with
// neither the check of corners nor the exact range; those not done after some jumps go on in a pool. The mixture is a
// table over the expected range per beam. limit.py compiles and calls this.
#include <immintrin.h>

#include <cmath>
#include <cstdint>
#include <vector>

namespace {

using F = __m256;
using I = __m256i;
constexpr int LANES = 8, GROUPS = 4, FIRST_STEPS = 4, MORE_STEPS = 3, POOL = 512;

struct Map {
    const uint16_t* table;
    int rows, cols;
    float max_cells;
};

// Eight rays, mirrored to run towards growing columns and rows; col and row count from the start cell.
struct Rays {
    F x, y, slope, inverse_slope, per_x, per_y, col, row;
    I start;
};
constexpr int FIELDS = 8;

I lane_numbers() { return _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7); }

// Loads one by one: gathering takes AMD's Zen 3 longer.
I look_up(const Map& map, I index) {
    alignas(32) uint32_t at[LANES];
    alignas(16) uint16_t size[LANES];
    _mm256_store_si256(reinterpret_cast<I*>(at), index);
    for (int j = 0; j < LANES; ++j) size[j] = map.table[at[j]];
    return _mm256_cvtepu16_epi32(_mm_load_si128(reinterpret_cast<__m128i*>(size)));
}

I cell_index(const Map& map, const Rays& r) {
    I row = _mm256_mullo_epi32(_mm256_cvttps_epi32(r.row), _mm256_set1_epi32(map.cols + 2));
    return _mm256_add_epi32(r.start, _mm256_add_epi32(row, _mm256_cvttps_epi32(r.col)));
}

// Jump to the exit of the rectangles of the given sizes; rays in occupied cells (size 0) stay.
void jump(const Map& map, Rays& r, I& size) {
    F edge_x = _mm256_add_ps(r.col, _mm256_cvtepi32_ps(_mm256_and_si256(size, _mm256_set1_epi32(255))));
    F edge_y = _mm256_add_ps(r.row, _mm256_cvtepi32_ps(_mm256_srli_epi32(size, 8)));
    F at_x = _mm256_fmadd_ps(_mm256_sub_ps(edge_x, r.x), r.slope, r.y);
    F at_y = _mm256_min_ps(_mm256_fmadd_ps(_mm256_sub_ps(edge_y, r.y), r.inverse_slope, r.x), edge_x);
    F x_first = _mm256_cmp_ps(at_x, edge_y, _CMP_LT_OQ);
    F cell = _mm256_floor_ps(_mm256_blendv_ps(at_y, at_x, x_first));
    F stopped = _mm256_castsi256_ps(_mm256_cmpeq_epi32(size, _mm256_setzero_si256()));
    r.col = _mm256_blendv_ps(_mm256_blendv_ps(cell, edge_x, x_first), r.col, stopped);
    r.row = _mm256_blendv_ps(_mm256_blendv_ps(edge_y, cell, x_first), r.row, stopped);
    size = look_up(map, cell_index(map, r));
}

// Lengths so far, and a bit for each ray that goes on.
F lengths(const Map& map, const Rays& r, I size, int& going) {
    F x = _mm256_mul_ps(_mm256_sub_ps(r.col, r.x), r.per_x), y = _mm256_mul_ps(_mm256_sub_ps(r.row, r.y), r.per_y);
    F longest = _mm256_set1_ps(map.max_cells), length = _mm256_max_ps(x, y);
    F open = _mm256_castsi256_ps(_mm256_cmpgt_epi32(size, _mm256_setzero_si256()));
    going = _mm256_movemask_ps(_mm256_and_ps(open, _mm256_cmp_ps(length, longest, _CMP_LT_OQ)));
    return _mm256_min_ps(_mm256_max_ps(length, _mm256_setzero_ps()), longest);
}

struct Pool {
    alignas(32) float field[FIELDS][POOL + 8 * LANES];
    alignas(32) int start[POOL + 8 * LANES], owner[POOL + 8 * LANES];
    alignas(32) int pack[256][LANES];
    int n = 0;

    Pool() : field{}, start{}, owner{} {
        for (int mask = 0; mask < 256; ++mask)
            for (int bit = 0, j = 0; bit < LANES; ++bit) {
                pack[mask][bit] = 0;
                if (mask >> bit & 1) pack[mask][j++] = bit;
            }
    }

    void push(const Rays& r, I owners, int mask) {
        I order = _mm256_load_si256(reinterpret_cast<const I*>(pack[mask]));
        const F* fields = &r.x;
        for (int f = 0; f < FIELDS; ++f) _mm256_storeu_ps(field[f] + n, _mm256_permutevar8x32_ps(fields[f], order));
        _mm256_storeu_si256(reinterpret_cast<I*>(start + n), _mm256_permutevar8x32_epi32(r.start, order));
        _mm256_storeu_si256(reinterpret_cast<I*>(owner + n), _mm256_permutevar8x32_epi32(owners, order));
        n += __builtin_popcount(mask);
    }

    // Let all jump; those that go on stay.
    void advance(const Map& map, float* out) {
        int all = n;
        n = 0;
        for (int i = 0; i < all; i += LANES) {
            Rays r;
            F* fields = &r.x;
            for (int f = 0; f < FIELDS; ++f) fields[f] = _mm256_load_ps(field[f] + i);
            r.start = _mm256_load_si256(reinterpret_cast<I*>(start + i));
            I owners = _mm256_load_si256(reinterpret_cast<I*>(owner + i));
            I valid = _mm256_cmpgt_epi32(_mm256_set1_epi32(all - i), lane_numbers());
            I size = look_up(map, _mm256_and_si256(cell_index(map, r), valid));
            for (int s = 0; s < MORE_STEPS; ++s) jump(map, r, size);
            int going, present = _mm256_movemask_ps(_mm256_castsi256_ps(valid));
            alignas(32) float length[LANES];
            alignas(32) int to[LANES];
            _mm256_store_ps(length, lengths(map, r, size, going));
            _mm256_store_si256(reinterpret_cast<I*>(to), owners);
            for (int done = present & ~going; done; done &= done - 1) {
                int j = __builtin_ctz(done);
                out[to[j]] = length[j];
            }
            if (going & present) push(r, owners, going & present);
        }
    }
};

// Rays from one point in eight directions.
Rays aim(const Map& map, F c, F s, F x, F y, F col, F row) {
    Rays r;
    F one = _mm256_set1_ps(1.0f), zero = _mm256_setzero_ps(), least = _mm256_set1_ps(1e-12f);
    F sign = _mm256_set1_ps(-0.0f);
    F west = _mm256_cmp_ps(c, zero, _CMP_LT_OQ), south = _mm256_cmp_ps(s, zero, _CMP_LT_OQ);
    F c_abs = _mm256_max_ps(_mm256_andnot_ps(sign, c), least), s_abs = _mm256_max_ps(_mm256_andnot_ps(sign, s), least);
    r.per_x = _mm256_div_ps(one, c_abs);
    r.per_y = _mm256_div_ps(one, s_abs);
    r.slope = _mm256_mul_ps(s_abs, r.per_x);
    r.inverse_slope = _mm256_mul_ps(c_abs, r.per_y);
    r.x = _mm256_blendv_ps(x, _mm256_sub_ps(one, x), west);
    r.y = _mm256_blendv_ps(y, _mm256_sub_ps(one, y), south);
    col = _mm256_blendv_ps(col, _mm256_sub_ps(_mm256_set1_ps(map.cols - 1), col), west);
    row = _mm256_blendv_ps(row, _mm256_sub_ps(_mm256_set1_ps(map.rows - 1), row), south);
    r.col = col;
    r.row = row;
    I quadrant = _mm256_add_epi32(_mm256_and_si256(_mm256_castps_si256(west), _mm256_set1_epi32(1)),
                                  _mm256_and_si256(_mm256_castps_si256(south), _mm256_set1_epi32(2)));
    I plane = _mm256_set1_epi32((map.rows + 2) * (map.cols + 2));
    r.start = _mm256_add_epi32(_mm256_mullo_epi32(quadrant, plane), _mm256_set1_epi32(map.cols + 3));
    r.start = cell_index(map, r);
    r.col = r.row = zero;
    return r;
}

}  // namespace

extern "C" {

// Lengths in cells of k beams from n poses (n, 3), which lie in the map; its origin is (0, 0, 0). The arrays of cosines
// and sines go on for 31 beams more.
void limit_cast(const uint16_t* table, int rows, int cols, float max_cells, const double* poses, int n,
                const float* beam_c, const float* beam_s, int k, double cells_per_metre, float* out) {
    Map map{table, rows, cols, max_cells};
    static thread_local Pool pool;
    for (int i = 0; i < n; ++i) {
        double x = poses[3 * i] * cells_per_metre, y = poses[3 * i + 1] * cells_per_metre;
        double col = std::floor(x), row = std::floor(y);
        F c = _mm256_set1_ps(cosf(poses[3 * i + 2])), s = _mm256_set1_ps(sinf(poses[3 * i + 2]));
        for (int first = 0; first < k; first += LANES * GROUPS) {
            Rays r[GROUPS];
            I size[GROUPS];
            for (int g = 0; g < GROUPS; ++g) {
                F u = _mm256_loadu_ps(beam_c + first + LANES * g), v = _mm256_loadu_ps(beam_s + first + LANES * g);
                F cos = _mm256_fmsub_ps(c, u, _mm256_mul_ps(s, v)), sin = _mm256_fmadd_ps(s, u, _mm256_mul_ps(c, v));
                r[g] = aim(map, cos, sin, _mm256_set1_ps(x - col), _mm256_set1_ps(y - row), _mm256_set1_ps(col),
                           _mm256_set1_ps(row));
                size[g] = look_up(map, r[g].start);
            }
            for (int step = 0; step < FIRST_STEPS; ++step)
                for (int g = 0; g < GROUPS; ++g) jump(map, r[g], size[g]);
            for (int g = 0; g < GROUPS; ++g) {
                int at = first + LANES * g, left = k - at, going;
                if (left <= 0) break;
                I valid = _mm256_cmpgt_epi32(_mm256_set1_epi32(left), lane_numbers());
                _mm256_maskstore_ps(out + i * k + at, valid, lengths(map, r[g], size[g], going));
                going &= _mm256_movemask_ps(_mm256_castsi256_ps(valid));
                I owners = _mm256_add_epi32(_mm256_set1_epi32(i * k + at), lane_numbers());
                if (going) pool.push(r[g], owners, going);
            }
            if (pool.n > POOL - LANES * GROUPS) pool.advance(map, out);
        }
    }
    while (pool.n > 0) pool.advance(map, out);
}

// The same, and the sum over beams of the logarithms in `table_of_beam` (k, bins + 1), linear between its entries.
void limit_beam(const uint16_t* table, int rows, int cols, float max_cells, const double* poses, int n,
                const float* beam_c, const float* beam_s, int k, double cells_per_metre, const float* table_of_beam,
                int bins, double* out) {
    constexpr int TOGETHER = 256;
    std::vector<float> lengths_of((size_t)TOGETHER * k + LANES);
    F per_bin = _mm256_set1_ps(bins / max_cells), last = _mm256_set1_ps(bins - 1);
    I row = _mm256_set1_epi32(bins + 1);
    for (int begin = 0; begin < n; begin += TOGETHER) {
        int count = n - begin < TOGETHER ? n - begin : TOGETHER;
        limit_cast(table, rows, cols, max_cells, poses + 3 * begin, count, beam_c, beam_s, k, cells_per_metre,
                   lengths_of.data());
        for (int i = 0; i < count; ++i) {
            F sum = _mm256_setzero_ps();
            for (int b = 0; b < k; b += LANES) {
                I valid = _mm256_cmpgt_epi32(_mm256_set1_epi32(k - b), lane_numbers());
                F z = _mm256_mul_ps(_mm256_maskload_ps(lengths_of.data() + i * k + b, valid), per_bin);
                I bin = _mm256_cvttps_epi32(_mm256_min_ps(z, last));
                I beam = _mm256_add_epi32(_mm256_set1_epi32(b), lane_numbers());
                I at = _mm256_and_si256(_mm256_add_epi32(_mm256_mullo_epi32(beam, row), bin), valid);
                F low = _mm256_i32gather_ps(table_of_beam, at, 4), high = _mm256_i32gather_ps(table_of_beam + 1, at, 4);
                F share = _mm256_sub_ps(z, _mm256_cvtepi32_ps(bin));
                F value = _mm256_fmadd_ps(share, _mm256_sub_ps(high, low), low);
                sum = _mm256_add_ps(sum, _mm256_and_ps(value, _mm256_castsi256_ps(valid)));
            }
            alignas(32) float part[LANES];
            _mm256_store_ps(part, sum);
            out[begin + i] = ((part[0] + part[1]) + (part[2] + part[3])) + ((part[4] + part[5]) + (part[6] + part[7]));
        }
    }
}
}
