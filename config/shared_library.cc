#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <memory>

#include <cxxabi.h>
#include <dlfcn.h>
#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/shared_library.h>

namespace iotcloud::config {

namespace {

/// A C++ name as it stands in the source; any other name as it is.
std::string demangled(const std::string& symbol) {
  int status = 0;
  const std::unique_ptr<char, decltype(&std::free)> text(abi::__cxa_demangle(symbol.c_str(), nullptr, nullptr, &status),
                                                         &std::free);
  return status == 0 ? std::string(text.get()) : symbol;
}

std::string versions(const std::string& path, const SdkMark& mark) {
  const auto built_with = marked_sdk_version(path, mark);
  if (built_with == 0)
    return fmt::format("it does not say with which {} it was built, this program has version {}", mark.sdk,
                       mark.expected);
  return fmt::format("it was built with {} version {}, this program has version {}", mark.sdk, built_with,
                     mark.expected);
}

}  // namespace

std::uint32_t marked_sdk_version(const std::string& path, const SdkMark& mark) {
  std::ifstream in(path, std::ios::binary);
  const std::string bytes(std::istreambuf_iterator<char>(in), {});
  constexpr std::size_t most_digits = 9;
  for (auto at = bytes.find(mark.text); at != std::string::npos; at = bytes.find(mark.text, at + 1)) {
    const auto begin = at + mark.text.size();
    const auto end = std::min(bytes.find_first_not_of("0123456789", begin), bytes.size());
    if (end > begin && end - begin <= most_digits && end < bytes.size() && bytes[end] == ';')
      return static_cast<std::uint32_t>(std::stoul(bytes.substr(begin, end - begin)));
  }
  return 0;
}

std::string why_not_loaded(const std::string& path, const std::string& name, const SdkMark& mark,
                           std::string_view reason) {
  const std::string own_path = path + ": ";
  if (reason.starts_with(own_path)) reason.remove_prefix(own_path.size());
  constexpr std::string_view undefined = "undefined symbol: ";
  if (const auto at = reason.find(undefined); at != std::string_view::npos) {
    const auto symbol = reason.substr(at + undefined.size());
    const std::string in_library = at == 0 ? "" : fmt::format(" (in {})", reason.substr(0, at - 2));
    return fmt::format(
        "{} cannot be loaded: nothing defines {}{}; add the source or the library that does to what it links, and link "
        "it with -Wl,-z,defs to hear of this from the linker; {}",
        name, demangled(std::string(symbol.substr(0, symbol.find_first_of(", \t\n")))), in_library,
        versions(path, mark));
  }
  return fmt::format("{} cannot be loaded: {}; {}", name, reason, versions(path, mark));
}

void* open_library(const std::string& path, const std::string& name, const SdkMark& mark, int flags) {
  void* const library = dlopen(path.c_str(), flags);
  if (library != nullptr) return library;
  const char* const reason = dlerror();
  throw Error(why_not_loaded(path, name, mark, reason == nullptr ? "the loader gives no reason" : reason));
}

}  // namespace iotcloud::config
