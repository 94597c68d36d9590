// Where rows and ports lie in a block, and the linear connections as matrices of it.
#pragma once

#include <algorithm>

#include "parts.hpp"

namespace tonewood {

// Rows of a (., width) matrix that are not zero.
inline std::vector<int> rows_in_use(const Array<double>& matrix, std::size_t width) {
    std::vector<int> rows;
    for (std::size_t i = 0; i * width < matrix.size(); ++i) {
        const auto row = matrix.begin() + std::ptrdiff_t(i * width);
        if (std::any_of(row, row + std::ptrdiff_t(width), [](double x) { return x != 0.0; })) rows.push_back(int(i));
    }
    return rows;
}

// Places every row and port and folds the connections into small matrices; see Layout.
inline Layout make_layout(const std::vector<Component>& components, const Solve& solve, int n_channels) {
    Layout l;
    // potentials' own passes write the rows of components that are stepped by sample
    const auto alike = [](const Component& c, int n) {
        return !c.driven && c.n_ports == n && c.n_rows == n && (n == 1 || !c.by_sample());
    };
    const int m = solve.m;
    l.row.assign(components.size(), 0), l.port.assign(components.size(), 0);
    l.by_itself = without_neighbours(components, solve);
    l.driven_response.resize(components.size()), l.stepped.assign(components.size(), 0);
    int n_ports = 0;
    const auto place = [&](Layout::Alike& those, int n) {
        those.row = l.width, those.force = n_ports;
        for (std::size_t i = 0; i < components.size(); ++i)
            if (alike(components[i], n)) {
                l.row[i] = those.row + n_ports - those.force, l.port[i] = n_ports;
                n_ports += n;
            }
        those.width = int(padded(n_ports - those.force)), l.width += those.width;
        those.response.assign(std::size_t(kBlock) * n * those.width, 0.0);
        for (std::size_t i = 0; i < components.size(); ++i)
            for (int kp = 0; alike(components[i], n) && kp < kBlock * n; ++kp)
                std::copy_n(components[i].response.data() + kp * n, n,
                            those.response.data() + std::size_t(kp) * those.width + (l.row[i] - those.row));
    };
    place(l.singles, 1), place(l.pairs, 2);
    for (std::size_t i = 0; i < components.size(); ++i) {
        const auto& c = components[i];
        if (alike(c, 1) || alike(c, 2)) continue;
        l.port[i] = n_ports, n_ports += c.n_ports;
        if (c.driven) {
            auto& h = l.driven_response[i];
            h.assign(std::size_t(c.n_ports) * c.n_rows * 2 * kBlock, 0.0);
            for (int k = 0; k < kBlock; ++k)
                for (int pr = 0; pr < c.n_ports * c.n_rows; ++pr)
                    h[std::size_t(pr) * 2 * kBlock + kBlock + k] = c.response[k * c.n_ports * c.n_rows + pr];
            continue;
        }
        const int width = int(padded(c.n_rows));
        l.row[i] = l.width, l.width += width;
        if (c.n_ports == 0 || c.by_sample()) continue;
        const bool stepped = c.shapes.on && !c.contact.n;
        if (stepped) l.stepped[i] = 1, l.sample_by_sample.push_back(int(i));
        const int lags = stepped ? 1 : kBlock;
        Array<double> response(std::size_t(lags) * c.n_ports * width, 0.0);
        for (int kp = 0; kp < lags * c.n_ports; ++kp)
            for (int r = 0; r < (stepped ? c.n_ports : c.n_rows); ++r)
                response[std::size_t(kp) * width + r] = c.response[kp * c.n_rows + r];
        l.several.push_back({l.row[i], l.port[i], c.n_ports, width, stepped, std::move(response)});
    }
    l.f_width = int(padded(m)), l.force_width = int(padded(n_ports));
    for (int o = 0; o < n_channels; ++o)
        for (int j = 0; j < m; ++j)
            if (const double w = solve.weights[std::size_t(o) * m + j]; w != 0.0) l.read_forces.push_back({o, j, w});
    l.constant = solve.constant;
    l.constant.resize(l.f_width, 0.0);
    for (std::size_t i = 0; i < components.size(); ++i)
        for (int p = 0; !components[i].driven && p < components[i].n_ports; ++p) {
            const int row = l.row[i] + p;
            if (!l.segments.empty() && row == l.port_rows.back() + 1)
                ++l.segments.back().n;
            else
                l.segments.push_back({row, int(l.port_rows.size()), 1});
            l.port_rows.push_back(row);
        }
    if ((l.in_parts = solve.in_parts)) {
        l.parts = make_parts(components, solve, l);
        return l;
    }
    l.scatter.assign(std::size_t(m) * l.force_width, 0.0);
    Array<double> of_free;
    for (std::size_t i = 0; i < components.size(); ++i)
        for (int p = 0; p < components[i].n_ports; ++p) {
            Array<double> of_new(l.f_width, 0.0), of_old(l.f_width, 0.0);
            for (const Share& s : components[i].shares[p]) {
                l.scatter[std::size_t(s.connection) * l.force_width + l.port[i] + p] += s.factor;
                for (int k = 0; k < m; ++k) {
                    const double g = solve.g[std::size_t(k) * m + s.connection] * s.factor;
                    of_new[k] -= g, of_old[k] -= g * solve.gamma[s.connection];
                }
            }
            if (components[i].driven) continue;
            l.gather.insert(l.gather.end(), of_old.begin(), of_old.end());
            of_free.insert(of_free.end(), of_new.begin(), of_new.end());
        }
    l.gather.insert(l.gather.end(), of_free.begin(), of_free.end());
    const auto scatter_to_ports = [&](const double* f, double* to) {
        for (int j = 0; j < m; ++j)
            for (int p = 0; p < n_ports; ++p) to[p] += f[j] * l.scatter[std::size_t(j) * l.force_width + p];
    };
    l.direct.width = l.force_width;
    l.direct.constant.assign(l.force_width, 0.0);
    scatter_to_ports(l.constant.data(), l.direct.constant.data());
    l.own_port.assign(m, -1), l.own_factor.assign(m, 0.0);
    for (std::size_t i = 0; i < components.size(); ++i)
        for (int p = 0; p < components[i].n_ports; ++p)
            if (const auto& shares = components[i].shares[p]; shares.size() == 1 && shares[0].factor != 0.0) {
                l.own_port[shares[0].connection] = l.port[i] + p;
                l.own_factor[shares[0].connection] = 1.0 / shares[0].factor;
            }
    if (std::find(l.own_port.begin(), l.own_port.end(), -1) != l.own_port.end()) l.own_port.clear();
    l.own_in_order = true;
    for (int j = 0; j < m && !l.own_port.empty(); ++j) l.own_in_order = l.own_in_order && l.own_port[j] == j;
    const std::size_t n_rows = l.port_rows.size();
    l.direct.mix = m ? solve.gamma[0] : 0.0;
    l.direct.free.assign(n_rows * l.force_width, 0.0), l.direct.old.assign(n_rows * l.force_width, 0.0);
    bool mixed_alike = true;
    for (std::size_t p = 0; p < n_rows; ++p) {
        Array<double> old(l.gather.data() + p * l.f_width, l.gather.data() + ((p + 1) * l.f_width));
        for (int j = 0; j < m; ++j) old[j] -= l.direct.mix * l.gather[(n_rows + p) * l.f_width + j];
        for (const double x : old) mixed_alike = mixed_alike && x == 0.0;
        scatter_to_ports(l.gather.data() + ((n_rows + p) * l.f_width), l.direct.free.data() + p * l.force_width);
        scatter_to_ports(old.data(), l.direct.old.data() + p * l.force_width);
    }
    if (mixed_alike) l.direct.old.clear();
    l.direct.rows = rows_in_use(l.direct.free, l.direct.width);
    return l;
}

}  // namespace tonewood
