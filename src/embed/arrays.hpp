// Reads files of named arrays, as tonewood.sound.render.model_file writes them: for each array a line "name type n0 n1 ..." (type f8 or i8, sizes
// in decimal, none for one number) and, after its newline, the numbers: little-endian, 8 bytes each, the last index fastest.
#pragma once

#include <bit>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <map>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace tonewood::saved {

static_assert(std::endian::native == std::endian::little, "numbers are read as they lie in the file");

struct Array {
    std::vector<std::size_t> shape;
    std::vector<double> f8;
    std::vector<std::int64_t> i8;
};

class File {
public:
    explicit File(const std::string& path) {
        std::ifstream stream(path, std::ios::binary);
        std::string line, name, type;
        if (!std::getline(stream, line) || line != "tonewood-arrays/1") throw std::runtime_error(path + ": not a file of arrays");
        while (std::getline(stream, line)) {
            std::istringstream words(line);
            Array array;
            std::size_t size = 1, n;
            words >> name >> type;
            while (words >> n) array.shape.push_back(n), size *= n;
            if (type != "f8" && type != "i8") throw std::runtime_error(path + ": no type " + type);
            array.f8.resize(type == "f8" ? size : 0), array.i8.resize(type == "i8" ? size : 0);
            char* const to = type == "f8" ? reinterpret_cast<char*>(array.f8.data()) : reinterpret_cast<char*>(array.i8.data());
            if (!stream.read(to, std::streamsize(8 * size))) throw std::runtime_error(path + ": " + name + " is cut short");
            arrays_[name] = std::move(array);
        }
    }
    bool has(const std::string& name) const { return arrays_.count(name) > 0; }
    const Array& operator[](const std::string& name) const {
        if (!has(name)) throw std::runtime_error("there is no " + name);
        return arrays_.at(name);
    }
    std::int64_t integer(const std::string& name) const { return arrays_.at(name).i8.at(0); }
    std::vector<int> integers(const std::string& name) const {
        const auto& a = arrays_.at(name).i8;
        return {a.begin(), a.end()};
    }

private:
    std::map<std::string, Array> arrays_;
};

// "what/i/"
inline std::string entry(const std::string& what, std::size_t i) { return what + "/" + std::to_string(i) + "/"; }

}  // namespace tonewood::saved
