/* The direct sum of dipole pair forces with AVX-512 intrinsics: the yardstick of granular.pairs.
 *
 * n is a multiple of 8; places behind the grains are so far away that their forces vanish. Forces in
 * units of F*, lengths in D: f = (3/4) r^-5 (r_i - r_j) on i. r^-5 from the processor's estimate y of
 * 1/r, with e = 1 - r^2 y^2, as y^5 (1 + 5/2 e + 35/8 e^2 + 105/16 e^3).
 */
#include <immintrin.h>
#include <string.h>

#define ROWS 4

static inline __m512d inverse_fifth(__m512d r2)
{
    __m512d y = _mm512_rsqrt14_pd(r2), y2 = _mm512_mul_pd(y, y);
    __m512d e = _mm512_fnmadd_pd(r2, y2, _mm512_set1_pd(1.0));
    __m512d y5 = _mm512_mul_pd(_mm512_mul_pd(y2, y2), y);
    __m512d q = _mm512_fmadd_pd(e, e, _mm512_set1_pd(8.0 / 21.0));
    q = _mm512_fmadd_pd(_mm512_add_pd(e, _mm512_set1_pd(2.0 / 3.0)), q,
                        _mm512_set1_pd(-32.0 / 315.0));
    return _mm512_mul_pd(y5, q);
}

void pair_forces(long n, const double *x, const double *y, double *fx, double *fy)
{
    const double scale = 0.75 * 105.0 / 16.0;
    memset(fx, 0, n * sizeof *fx);
    memset(fy, 0, n * sizeof *fy);
    for (long b = 0; b < n; b += 8) {
        __m512d bx = _mm512_loadu_pd(x + b), by = _mm512_loadu_pd(y + b);
        __m512d gx = _mm512_loadu_pd(fx + b), gy = _mm512_loadu_pd(fy + b);
        for (int l = 0; l < 8; l++) {
            __m512d dx = _mm512_sub_pd(bx, _mm512_set1_pd(x[b + l]));
            __m512d dy = _mm512_sub_pd(by, _mm512_set1_pd(y[b + l]));
            __m512d s = inverse_fifth(_mm512_fmadd_pd(dx, dx, _mm512_mul_pd(dy, dy)));
            s = _mm512_maskz_mov_pd((__mmask8)~(1 << l), s);
            gx = _mm512_fmadd_pd(s, dx, gx);
            gy = _mm512_fmadd_pd(s, dy, gy);
        }
        _mm512_storeu_pd(fx + b, gx);
        _mm512_storeu_pd(fy + b, gy);
        for (long i = b; i < b + 8; i += ROWS) {
            __m512d xi[ROWS], yi[ROWS], ax[ROWS], ay[ROWS];
            for (int r = 0; r < ROWS; r++) {
                xi[r] = _mm512_set1_pd(x[i + r]);
                yi[r] = _mm512_set1_pd(y[i + r]);
                ax[r] = ay[r] = _mm512_setzero_pd();
            }
            for (long j = b + 8; j < n; j += 8) {
                __m512d xj = _mm512_loadu_pd(x + j), yj = _mm512_loadu_pd(y + j);
                __m512d hx = _mm512_loadu_pd(fx + j), hy = _mm512_loadu_pd(fy + j);
#pragma GCC unroll 4
                for (int r = 0; r < ROWS; r++) {
                    __m512d dx = _mm512_sub_pd(xi[r], xj), dy = _mm512_sub_pd(yi[r], yj);
                    __m512d s = inverse_fifth(_mm512_fmadd_pd(dx, dx, _mm512_mul_pd(dy, dy)));
                    __m512d px = _mm512_mul_pd(s, dx), py = _mm512_mul_pd(s, dy);
                    ax[r] = _mm512_add_pd(ax[r], px);
                    ay[r] = _mm512_add_pd(ay[r], py);
                    hx = _mm512_sub_pd(hx, px);
                    hy = _mm512_sub_pd(hy, py);
                }
                _mm512_storeu_pd(fx + j, hx);
                _mm512_storeu_pd(fy + j, hy);
            }
            for (int r = 0; r < ROWS; r++) {
                fx[i + r] += _mm512_reduce_add_pd(ax[r]);
                fy[i + r] += _mm512_reduce_add_pd(ay[r]);
            }
        }
    }
    for (long i = 0; i < n; i++) {
        fx[i] *= scale;
        fy[i] *= scale;
    }
}
