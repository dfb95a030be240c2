// keys new, sign: no master is asked
#include <filesystem>
#include <ostream>
#include <string>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <sys/stat.h>
#include <unistd.h>

#include <iotcloud/config/durable_write.h>
#include <iotcloud/config/error.h>
#include <iotcloud/master/cli/options.h>
#include <iotcloud/master/cli/verb.h>
#include <iotcloud/security/ed25519.h>
#include <iotcloud/security/plugin_signature.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::master::cli {

namespace {

constexpr mode_t for_owner = S_IRUSR | S_IWUSR;
constexpr mode_t for_all = for_owner | S_IRGRP | S_IROTH;

/// Makes the file of a key, which has these rights from the beginning.
void write_key(const std::string& path, const std::string& text, mode_t rights) try {
  config::write_new_file(path, text, rights);
} catch (const config::Error& e) {
  if (!std::filesystem::exists(path)) throw;
  throw config::Error(fmt::format("{}; a key is never overwritten: give another name, or move it away", e.what()));
}

class NewKeys final : public Verb {
 public:
  NewKeys()
      : Verb({"new", "Make a pair of Ed25519 keys: PATH.key signs, and is yours alone; PATH.pub is for the gateways",
              "iotcloud keys new ~/keys/lab", std::nullopt}) {}
  void declare(CLI::App& options) override {
    options.add_option("PATH", path_, "how the files' names begin")->required();
  }
  int run(Call& call) override {
    const auto keys = security::new_key_pair();
    const std::string secret = path_ + ".key", open_one = path_ + ".pub";
    write_key(secret, keys.private_pem, for_owner);
    try {
      write_key(open_one, keys.public_pem, for_all);
    } catch (const config::Error&) {
      unlink(secret.c_str());
      throw;
    }
    if (call.format != Format::table) {
      print_data(call.out, call.format, {{"private_key", secret}, {"public_key", open_one}});
      return exit_ok;
    }
    call.out << fmt::format(
        "{}: keep it to yourself; sign plugins with `iotcloud sign FILE --key {}`\n"
        "{}: name it in the gateways' plugins.trusted_keys\n",
        secret, secret, open_one);
    return exit_ok;
  }

 private:
  std::string path_;
};

class Sign final : public Verb {
 public:
  Sign()
      : Verb({"sign", "Sign a plugin: writes FILE.sig, which goes where FILE goes",
              "iotcloud sign turtle.so --key ~/keys/lab.key --version 7", std::nullopt}) {}
  void declare(CLI::App& options) override {
    options.add_option("FILE", file_, "the plugin")->required();
    options.add_option("--key", key_, "a private Ed25519 key in PEM")->required()->type_name("KEY");
    auto& version = *options
                         .add_option("--version", version_,
                                     "its version, from 1: where it ran, no older one runs any more. Without: none")
                         ->check(CLI::PositiveNumber)
                         ->type_name("N");
    options.add_option("--name", name_, "what it is a version of; FILE's name without its ending if not given")
        ->needs(&version)
        ->type_name("NAME");
  }
  int run(Call& call) override {
    const std::string plugin = bytes_of(file_);
    if (name_.empty()) name_ = std::filesystem::path(file_).stem();
    const std::string signature = version_ == 0 ? security::sign(bytes_of(key_), key_, plugin)
                                                : security::sign_plugin(bytes_of(key_), key_, plugin, name_, version_);
    const std::string place = file_ + ".sig";
    config::replace_file(place, signature, for_all);  // a reader finds either the old signature or the new one
    const std::string sha256 = security::sha256_hex(plugin);
    if (call.format != Format::table) {
      print_data(call.out, call.format, {{"signature", place}, {"bytes", plugin.size()}, {"sha256", sha256}});
      return exit_ok;
    }
    call.out << fmt::format("{}: of the {} bytes with the SHA-256 {}\n", place, plugin.size(), sha256);
    return exit_ok;
  }

 private:
  std::string file_, key_, name_;
  std::uint64_t version_ = 0;
};

}  // namespace

void add_signing_verbs(Verbs& verbs) {
  verbs.group("keys", "Keys with which plugins are signed").add<NewKeys>();
  verbs.add<Sign>();
}

}  // namespace iotcloud::master::cli
