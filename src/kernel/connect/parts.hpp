// Forces of linear connections whose inverse is given in parts (physics/coupling/inverse.py):
//
//     f = c - B (e + U u) + B U K q,      q = U^T B (e + U u),      e: gaps without the hub, u: its r motions,
//
// so that with w = K q, which the connections take off the hub's motion,
//
//     q = P^T (Q^T B e) + H u,      f = c - B e - B Q P (u - w),      hub's forces U^T f = U^T c - q + H w.
#pragma once

#include <algorithm>

#include "products.hpp"

namespace tonewood {
namespace {

// y = matrix x (Sign 0), or y += sign matrix x
template <int Sign>
inline void multiply(const SparseRows& a, const double* __restrict x, double* __restrict y) {
    using S = Simd;
    if (Sign == 0) std::fill_n(y, a.width, 0.0);
    for (const auto& layer : a.layers) {
        const double* const __restrict value = layer.value.data();
        if (layer.in_order) {
            for (int i = layer.first; i < layer.end; i += S::width) {
                const S::V product = S::load(value + i) * S::load(x + layer.shift + i);
                S::store(y + i, Sign < 0 ? S::load(y + i) - product : S::load(y + i) + product);
            }
            continue;
        }
        const int* const __restrict column = layer.column.data();
        for (int i = layer.first; i < layer.end; ++i)
            if (Sign < 0) y[i] -= value[i] * x[column[i]];
            else y[i] += value[i] * x[column[i]];
    }
    for (const Entry& e : a.rest) y[e.row] += (Sign < 0 ? -e.value : e.value) * x[e.column];
}

class ForcesInParts {
    using S = Simd;

public:
    explicit ForcesInParts(const Layout& layout)
        : l_(layout), p_(layout.parts), now_(padded(layout.port_rows.size()) + 2 * kLane), before_(now_.size()),
          gap_(p_.gaps.width + kLane), old_(gap_), at_points_(p_.point_width + kLane), moved_(at_points_),
          u_(p_.r_width + kLane), q_(u_), w_(u_), rest_(u_) {}

    bool on() const { return l_.in_parts; }

    // Forces f of the connections and `now` on all fixed ports, from lines b and b + 1 of the row history.
    __attribute__((flatten, noinline)) void operator()(const double* __restrict line, double* __restrict f,
                                             double* __restrict now) {
        for (const Layout::Segment& segment : l_.segments)
            for (int i = 0; i < segment.n; i += S::width) {
                const double* at = line + segment.row + i;
                S::store(now_.data() + segment.port + i, S::load(at + l_.width));
                S::store(before_.data() + segment.port + i, S::load(at));
            }
        multiply<0>(p_.gaps, now_.data(), gap_.data());
        multiply<0>(p_.gaps, before_.data(), old_.data());
        for (int j = 0; j < p_.gaps.width; ++j) gap_[j] += p_.gamma[j] * old_[j];
        std::copy(l_.constant.begin(), l_.constant.end(), f);
        for (int i = 0; i < p_.r; ++i)
            rest_[i] = before_[p_.rows[i]], u_[i] = now_[p_.rows[i]] + p_.hub_gamma * rest_[i];
        multiply<1>(p_.old, rest_.data(), gap_.data());
        multiply<-1>(p_.blocks, gap_.data(), f);
        if (p_.r) {
            load(gap_.data());
            stiffen(u_.data(), q_.data());
            join();
            for (int i = 0; i < p_.r; ++i) rest_[i] = u_[i] - w_[i];
            reach(rest_.data(), f);
        }
        multiply<0>(p_.forces, f, now);
        if (p_.r) {
            for (int i = 0; i < p_.r_width; ++i) rest_[i] = p_.constant[i] - q_[i];
            stiffen(w_.data(), rest_.data());
            for (int i = 0; i < p_.r; ++i) now[p_.to[i]] = rest_[i];
        }
    }

    // Forces on all fixed ports of given forces of the connections.
    void scatter(const double* f, double* now) {
        multiply<0>(p_.forces, f, now);
        if (!p_.r) return;
        onto_motions(p_.onto_points, f);
        for (int i = 0; i < p_.r; ++i) now[p_.to[i]] = q_[i];
    }

    // f = G times displacements of the gaps.
    void answer(const double* gaps, double* f) {
        std::copy_n(gaps, p_.m, gap_.begin());
        std::fill_n(f, p_.gaps.width, 0.0);
        add_answer<1>(f);
    }

    // f -= G times the gaps under displacements of two-way ports.
    void subtract_answer(const double* ports, double* f) {
        multiply<0>(p_.gaps, ports, gap_.data());
        add_answer<-1>(f);
    }

private:
    // f += sign G gap
    template <int Sign>
    void add_answer(double* f) {
        multiply<Sign>(p_.blocks, gap_.data(), f);
        if (!p_.r) return;
        load(gap_.data());
        join();
        for (int i = 0; i < p_.r; ++i) rest_[i] = Sign * w_[i];
        reach(rest_.data(), f);
    }
    // q = P^T (matrix x), matrix (points, connections)
    void onto_motions(const SparseRows& matrix, const double* x) {
        if (p_.own_motions) return multiply<0>(matrix, x, q_.data());
        multiply<0>(matrix, x, at_points_.data());
        std::fill(q_.begin(), q_.end(), 0.0);
        add_product(p_.span.data(), p_.r_width, at_points_.data(), p_.points, q_.data());
    }
    void load(const double* gaps) { onto_motions(p_.load, gaps); }
    // y += H x
    void stiffen(const double* x, double* y) const {
        if (p_.own_motions) multiply<1>(p_.own_stiffness, x, y);
        else add_product(p_.stiffness.data(), p_.r_width, x, p_.r, y);
    }
    // w = K q
    void join() {
        std::fill(w_.begin(), w_.end(), 0.0);
        add_product(p_.joined.data(), p_.r_width, q_.data(), p_.r, w_.data());
    }
    // f -= B Q P x
    void reach(const double* x, double* f) {
        if (p_.own_motions) return multiply<-1>(p_.reach, x, f);
        std::fill(moved_.begin(), moved_.end(), 0.0);
        add_product(p_.motion.data(), p_.point_width, x, p_.r, moved_.data());
        multiply<-1>(p_.reach, moved_.data(), f);
    }

    const Layout& l_;
    const Parts& p_;
    Array<double> now_, before_, gap_, old_, at_points_, moved_, u_, q_, w_, rest_;
};

}  // namespace
}  // namespace tonewood
