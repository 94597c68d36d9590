// What module.cpp takes of nanobind, without Python: arrays that are pointers with a shape, and bindings that do nothing.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

namespace nanobind {

struct c_contig {};
namespace device {
struct cpu {};
}  // namespace device

template <class T, class...>
class ndarray {
public:
    ndarray(T* data, std::vector<std::size_t> shape) : data_(data), shape_(std::move(shape)) {}
    T* data() const { return data_; }
    std::size_t ndim() const { return shape_.size(); }
    std::size_t shape(std::size_t i) const { return shape_[i]; }
    std::size_t size() const {
        std::size_t n = 1;
        for (const std::size_t s : shape_) n *= s;
        return n;
    }

private:
    T* data_;
    std::vector<std::size_t> shape_;
};

struct gil_scoped_release {
    ~gil_scoped_release() {}
};
struct arg {
    arg noconvert() const { return {}; }
};
template <class...>
struct init {};
struct module_ {
    struct Attribute {
        template <class T>
        void operator=(const T&) {}
    };
    Attribute attr(const char*) { return {}; }
    Attribute doc() { return {}; }
    template <class... A>
    void def(const A&...) {}
};
template <class T>
struct class_ {
    class_(module_&, const char*) {}
    template <class... A>
    class_& def(const A&...) { return *this; }
};

}  // namespace nanobind

#define NB_MODULE(name, m) [[maybe_unused]] static void bindings(nanobind::module_& m)
