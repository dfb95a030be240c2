#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <ostream>
#include <string>

#include <fcntl.h>
#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <sys/stat.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/signing/ed25519.h>
#include <iotcloud/config/signing/sha256.h>
#include <iotcloud/master/cli/output.h>
#include <iotcloud/master/cli/plugins/signing_command.h>

namespace iotcloud::master::cli {

namespace {

constexpr mode_t for_owner = S_IRUSR | S_IWUSR;
constexpr mode_t for_all = for_owner | S_IRGRP | S_IROTH;

/// A new file: it has these rights from the beginning.
void write_new(const std::string& path, const std::string& text, mode_t rights) {
  const int file = open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, rights);
  if (file < 0)
    throw config::Error(
        fmt::format("{} cannot be made: {}{}", path, std::strerror(errno),
                    errno == EEXIST ? "; a key is never overwritten: give another name, or move it away" : ""));
  const bool whole = write(file, text.data(), text.size()) == static_cast<ssize_t>(text.size()) && fsync(file) == 0;
  const int problem = errno;
  close(file);
  if (whole) return;
  unlink(path.c_str());
  throw config::Error(fmt::format("{} cannot be written: {}", path, std::strerror(problem)));
}

std::string bytes_of(const std::string& path) {
  if (std::filesystem::is_directory(path)) throw config::Error(fmt::format("{} is a folder, not a file", path));
  std::ifstream in(path, std::ios::binary);
  std::string bytes(std::istreambuf_iterator<char>(in), {});
  if (!in) throw config::Error(fmt::format("{} cannot be read: {}", path, std::strerror(errno)));
  return bytes;
}

}  // namespace

int make_keys(const Command& command, std::ostream& out) {
  const auto keys = config::new_key_pair();
  const std::string secret = command.file + ".key", open_one = command.file + ".pub";
  write_new(secret, keys.private_pem, for_owner);
  try {
    write_new(open_one, keys.public_pem, for_all);
  } catch (const config::Error&) {
    unlink(secret.c_str());
    throw;
  }
  if (command.format != Format::table) {
    print_data(out, command.format, {{"private_key", secret}, {"public_key", open_one}});
    return exit_ok;
  }
  out << fmt::format(
      "{}: keep it to yourself; sign plugins with `iotcloud sign FILE --key {}`\n"
      "{}: name it in the gateways' plugins.trusted_keys\n",
      secret, secret, open_one);
  return exit_ok;
}

int sign_plugin(const Command& command, std::ostream& out) {
  const std::string plugin = bytes_of(command.file);
  const std::string signature = config::sign(bytes_of(command.key), command.key, plugin);
  // Beside and then in its place: whoever looks finds the former one or this one.
  const std::string place = command.file + ".sig", fresh = place + ".new";
  unlink(fresh.c_str());
  write_new(fresh, signature, for_all);
  if (std::rename(fresh.c_str(), place.c_str()) != 0)
    throw config::Error(fmt::format("{} cannot be written: {}", place, std::strerror(errno)));
  const std::string sha256 = config::sha256_hex(plugin);
  if (command.format != Format::table) {
    print_data(out, command.format, {{"signature", place}, {"bytes", plugin.size()}, {"sha256", sha256}});
    return exit_ok;
  }
  out << fmt::format("{}: of the {} bytes with the SHA-256 {}\n", place, plugin.size(), sha256);
  return exit_ok;
}

}  // namespace iotcloud::master::cli
