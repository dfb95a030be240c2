#pragma once

#include <chrono>
#include <filesystem>
#include <stdexcept>
#include <string>
#include <string_view>
#include <system_error>
#include <utility>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

/// A file to which several processes append lines. A line is one write(2), so it is whole, and it survives kill -9 of
/// its writer. tests/chaos/ledger.py reads these files. Not thread safe.
class Book {
 public:
  Book() = default;
  /// \throws std::system_error when the file cannot be opened.
  explicit Book(const std::filesystem::path& file)
      : descriptor_(::open(file.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644)) {
    if (descriptor_ < 0) throw std::system_error(errno, std::generic_category(), file.string());
  }
  Book(Book&& other) noexcept : descriptor_(std::exchange(other.descriptor_, -1)) {}
  Book& operator=(Book&& other) noexcept {
    std::swap(descriptor_, other.descriptor_);
    return *this;
  }
  ~Book() {
    if (descriptor_ >= 0) ::close(descriptor_);
  }

  /// Appends the words and the time of the line in seconds. That is the machine's time since it was started, which all
  /// processes share and no step of the clock changes. \throws std::system_error when the line cannot be written whole.
  void write(const std::string& words) {
    const auto now = std::chrono::steady_clock::now().time_since_epoch();
    const std::string line = words + ' ' + std::to_string(std::chrono::duration<double>(now).count()) + '\n';
    if (::write(descriptor_, line.data(), line.size()) != static_cast<ssize_t>(line.size())) {
      throw std::system_error(errno, std::generic_category(), "a book of messages");
    }
  }

 private:
  int descriptor_ = -1;
};

/// The text of a message of the ledger driver: "INSTANCE RUN NUMBER".
struct Entry {
  std::string instance;
  std::string run_and_number;

  /// \throws std::invalid_argument when the text is no entry.
  static Entry parse(std::string_view text) {
    const auto blank = text.find(' ');
    if (blank != 32 || text.find(' ', blank + 1) == std::string_view::npos ||
        text.find('/') != std::string_view::npos) {
      throw std::invalid_argument("a message that no ledger driver sent");
    }
    return {std::string(text.substr(0, blank)), std::string(text.substr(blank + 1))};
  }
};
