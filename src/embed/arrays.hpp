// Reads files of named arrays, as tonewood.sound.render.model_file writes them: for each array a line
// "name type n0 n1 ..." (type f8 or i8, sizes in decimal, none for one number) and, after its newline, the numbers:
// little-endian, 8 bytes each, the last index fastest.
//
// A file is not trusted: every size is compared with the bytes that are left before anything is allocated, and every
// number is finite. What does not fit throws std::runtime_error with one line that names file and array.
#pragma once

#include <bit>
#include <charconv>
#include <climits>
#include <cmath>
#include <cstdint>
#include <fstream>
#include <istream>
#include <map>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

namespace tonewood::saved {

static_assert(std::endian::native == std::endian::little, "numbers are read as they lie in the file");

constexpr std::size_t kMostDimensions = 4, kLongestLine = 255;

struct Array {
    std::vector<std::size_t> shape;
    std::vector<double> f8;
    std::vector<std::int64_t> i8;
    bool is_f8 = false;
    mutable bool is_read = false;
};

class File {
public:
    explicit File(const std::string& path) : path_(path) {
        std::ifstream stream(path, std::ios::binary);
        if (!stream) refuse("cannot be opened");
        read(stream);
    }
    // `path` is only named in errors.
    File(std::istream& stream, const std::string& path) : path_(path) { read(stream); }

    bool has(const std::string& name) const { return arrays_.count(name) > 0; }
    const Array& operator[](const std::string& name) const {
        const auto at = arrays_.find(name);
        if (at == arrays_.end()) refuse(name + " is missing");
        at->second.is_read = true;
        return at->second;
    }
    const Array& floats(const std::string& name) const {
        const Array& a = (*this)[name];
        if (!a.is_f8) refuse(name + " is i8, not f8");
        return a;
    }
    double number(const std::string& name) const {
        const Array& a = floats(name);
        if (!a.shape.empty()) refuse(name + " is no single number");
        return a.f8.front();
    }
    std::int64_t integer(const std::string& name, std::int64_t least, std::int64_t most) const {
        const Array& a = (*this)[name];
        if (a.is_f8 || !a.shape.empty()) refuse(name + " is no single i8");
        const std::int64_t x = a.i8.front();
        if (x < least || x > most)
            refuse(name + " is " + std::to_string(x) + ", not " + std::to_string(least) + " to " + std::to_string(most));
        return x;
    }
    int index(const std::string& name) const { return int(integer(name, 0, INT_MAX)); }
    // Integers, last dimension `last` where it is not zero, and one dimension before it.
    std::vector<int> integers(const std::string& name, std::size_t last = 0) const {
        const Array& a = (*this)[name];
        if (a.is_f8) refuse(name + " is f8, not i8");
        if (a.shape.size() != (last ? 2u : 1u) || (last && a.shape.back() != last)) refuse(name + " has another shape");
        for (const std::int64_t x : a.i8)
            if (x < INT_MIN || x > INT_MAX) refuse(name + " has the value " + std::to_string(x));
        return {a.i8.begin(), a.i8.end()};
    }
    // Refuses arrays under `prefix` that nothing has read: beyond a gap in a list, or of a part that is incomplete. Empty
    // lists stand there as arrays without numbers.
    void require_all_read(const std::string& prefix) const {
        for (auto at = arrays_.lower_bound(prefix); at != arrays_.end() && at->first.starts_with(prefix); ++at)
            if (!at->second.is_read && !(at->second.f8.empty() && at->second.i8.empty()))
                refuse(at->first + " belongs to nothing: what stands before it is missing");
    }
    [[noreturn]] void refuse(const std::string& reason) const { throw std::runtime_error(path_ + ": " + reason); }

private:
    static constexpr std::string_view kMagic = "tonewood-arrays/1";

    // The next line, at most kLongestLine characters; whether there is one.
    bool line(std::istream& stream, std::string& out, std::uint64_t& left) const {
        out.clear();
        for (int c; (c = stream.get()) != std::istream::traits_type::eof();) {
            --left;
            if (c == '\n') return true;
            if (out.size() == kLongestLine) refuse("a line is longer than " + std::to_string(kLongestLine) + " bytes");
            out.push_back(char(c));
        }
        if (!out.empty()) refuse("ends within a line");
        return false;
    }

    void read(std::istream& stream) {
        // a folder opens as a file does, and a device has no end: the first line is read before the size counts
        std::string text(kMagic.size() + 1, '\0');
        if (!stream.read(text.data(), std::streamsize(text.size())) || text != std::string(kMagic) + '\n')
            refuse("not a file of arrays");
        const auto first = stream.tellg();
        const auto end = stream.seekg(0, std::ios::end).tellg();
        if (!stream.seekg(first) || end < first) refuse("cannot be read: it has no length");
        const std::uint64_t length = std::uint64_t(end - first);
        for (std::uint64_t left = length; line(stream, text, left);) {
            const std::size_t space = text.find(' ');
            const std::string name = text.substr(0, space);
            constexpr auto allowed = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_/.-";
            if (space == std::string::npos || name.empty() || name.find_first_not_of(allowed) != std::string::npos)
                refuse("a line names no array");
            std::string_view rest = std::string_view(text).substr(space + 1);
            Array array;
            array.is_f8 = rest.starts_with("f8");
            if (!array.is_f8 && !rest.starts_with("i8")) refuse(name + " has no type f8 or i8");
            rest.remove_prefix(2);
            const std::uint64_t most = left / 8;
            std::uint64_t size = 1;
            while (!rest.empty()) {
                std::uint64_t n = 0;
                const auto [after, fault] = std::from_chars(rest.data() + 1, rest.data() + rest.size(), n);
                if (rest[0] != ' ' || fault != std::errc{} || n > INT_MAX || n > length ||
                    array.shape.size() == kMostDimensions)
                    refuse(name + " has a shape that is not allowed");
                rest.remove_prefix(std::size_t(after - rest.data()));
                array.shape.push_back(n);
                if (n != 0 && size > most / n) refuse(name + " is cut short, or its shape is too large");
                size *= n;
            }
            if (size > most) refuse(name + " is cut short, or its shape is too large");
            if (array.is_f8) take(stream, array.f8, size, name);
            else take(stream, array.i8, size, name);
            left -= 8 * size;
            for (std::size_t i = 0; i < array.f8.size(); ++i)
                if (!std::isfinite(array.f8[i])) refuse(name + " is not finite at " + std::to_string(i));
            if (!arrays_.emplace(name, std::move(array)).second) refuse(name + " stands twice");
        }
    }
    template <class T>
    void take(std::istream& stream, std::vector<T>& to, std::size_t size, const std::string& name) const {
        to.resize(size);
        if (!stream.read(reinterpret_cast<char*>(to.data()), std::streamsize(8 * size))) refuse(name + " is cut short");
    }

    std::string path_;
    std::map<std::string, Array> arrays_;
};

// "what/i/"
inline std::string entry(const std::string& what, std::size_t i) { return what + "/" + std::to_string(i) + "/"; }

}  // namespace tonewood::saved
