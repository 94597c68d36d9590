// A component of many ports whose modes are real, stepped sample by sample: mode k moves port p by phi_kp times one
// number.
//
// In each sample the forces F on the ports become modal forces, the modes move, and their rows become the free motion
// of the next sample,
//
//     f_k = sum_p phi_kp F_p,    x+ = E x + f drive,    y_p = sum_k phi_kp (read E x+)_k,
//
// 2 n r multiply-adds of one matrix of n r numbers that is loaded once. By rows (pass.hpp) and with responses of 16
// samples (Propagate) it would take 5 n r + 8 r^2 multiply-adds and 8 n r + 16 r^2 numbers.
#pragma once

#include "pass.hpp"

namespace tonewood {
namespace {

class ShapeStep {
    using S = Simd;
    using V = Simd::V;

public:
    ShapeStep(const Component& c, double* x, double* y, const std::vector<Input>& inputs)
        : c_(c), s_(c.shapes), n_(std::size_t(c.n)), x_(x), y_(y), inputs_(inputs) {}

    // Rows at the block's beginning, and those of the ports at its first sample without forces.
    void begin(double* now, double* next) const {
        std::fill_n(now, s_.width, 0.0), std::fill_n(next, s_.width, 0.0);
        alignas(64) double ports[S::width], later[S::width];
        for (std::size_t k = 0; k < n_; k += S::width) {
            const V x = S::load(x_ + k), y = S::load(y_ + k);
            S::store(ports, S::load(s_.read.data() + k) * x + S::load(s_.read.data() + n_ + k) * y);
            S::store(later, free_after(k, x, y, 0));
            add_rows(k, ports, now);
            add_rows(k, later, next);
        }
        read_out(now);
    }

    // Moves the modes by sample b. Writes the readouts after it to `now` and, unless it is the block's last, the ports'
    // free motion after the next one to `next`.
    __attribute__((flatten)) void sample(int b, const double* force, double* now, double* next) const {
        const double *const e = c_.e.data(), *const drive = s_.drive.data();
        if (next) std::fill_n(next, s_.width, 0.0);
        alignas(64) double lanes[S::width * S::width], later[S::width];
        for (std::size_t k = 0; k < n_; k += S::width) {
            const double* const rows = s_.phi.data() + k * s_.width;
            V sum[S::width] = {};
            for (std::size_t p = 0; p < s_.width; p += S::width) {
                const V at = S::load(force + p);
                for (int i = 0; i < S::width; ++i) sum[i] += S::load(rows + std::size_t(i) * s_.width + p) * at;
            }
            for (int i = 0; i < S::width; ++i) S::store(lanes + i * S::width, sum[i]);
            const V f = sums<S::width>(lanes), x = S::load(x_ + k), y = S::load(y_ + k);
            V nx = S::load(e + k) * x + (S::load(e + n_ + k) * y + S::load(drive + k) * f);
            V ny = S::load(e + 3 * n_ + k) * y + (S::load(e + 2 * n_ + k) * x + S::load(drive + n_ + k) * f);
            for (const Input& input : inputs_) {
                nx += S::load(input.vector + k) * input.values[b];
                ny += S::load(input.vector + n_ + k) * input.values[b];
            }
            S::store(x_ + k, nx), S::store(y_ + k, ny);
            if (!next) continue;
            S::store(later, free_after(k, nx, ny, b + 1));
            add_rows(k, later, next);
        }
        read_out(now);
    }

private:
    // Rows of the modes after a sample without forces.
    V free_after(std::size_t k, V x, V y, int b) const {
        V out = S::load(s_.read_next.data() + k) * x + S::load(s_.read_next.data() + n_ + k) * y;
        for (const Input& input : inputs_)
            out += (S::load(s_.read.data() + k) * S::load(input.vector + k) +
                    S::load(s_.read.data() + n_ + k) * S::load(input.vector + n_ + k)) * input.values[b];
        return out;
    }

    // ports += phi^T of the modes from k
    void add_rows(std::size_t k, const double* modes, double* ports) const {
        const double* const rows = s_.phi.data() + k * s_.width;
        V each[S::width];
        for (int i = 0; i < S::width; ++i) each[i] = V{} + modes[i];
        for (std::size_t p = 0; p < s_.width; p += S::width) {
            V even = S::load(ports + p), odd{};
            for (int i = 0; i < S::width; i += 2) {
                even += S::load(rows + std::size_t(i) * s_.width + p) * each[i];
                odd += S::load(rows + std::size_t(i + 1) * s_.width + p) * each[i + 1];
            }
            S::store(ports + p, even + odd);
        }
    }

    void read_out(double* now) const {
        for (int r = c_.n_ports; r < c_.n_rows; ++r) {
            const double* const row = c_.rows.data() + 2 * std::size_t(r) * n_;
            V sum{};
            for (std::size_t k = 0; k < n_; k += S::width)
                sum += S::load(row + k) * S::load(x_ + k) + S::load(row + n_ + k) * S::load(y_ + k);
            now[r] = S::sum(sum);
        }
    }

    const Component& c_;
    const Shapes& s_;
    const std::size_t n_;
    double *const x_, *const y_;
    const std::vector<Input>& inputs_;
};

}  // namespace
}  // namespace tonewood
