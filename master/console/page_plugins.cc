#include <algorithm>
#include <array>
#include <cctype>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <optional>
#include <utility>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <openssl/evp.h>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/description/json.h>
#include <iotcloud/master/console/page_plugins.h>
#include <iotcloud/master/logger.h>
#include <iotcloud/security/plugin_signature.h>

namespace iotcloud::master {

namespace {

constexpr std::string_view ending = ".js", head_mark = "// iotcloud page: ";
constexpr std::size_t most_script_bytes = std::size_t{1} << 20U, most_head_bytes = 1'024, longest_name = 64;

bool is_name(const std::string& text) {
  const auto fits = [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '-' || c == '_';
  };
  return !text.empty() && text.size() <= longest_name && std::all_of(text.begin(), text.end(), fits);
}

/// The bytes of a file, one more than `most` of a longer one; nullopt: it is not there.
std::optional<std::string> bytes_of(const std::string& path, std::size_t most) {
  if (!std::filesystem::exists(path)) return std::nullopt;
  std::ifstream in(path, std::ios::binary);
  std::string bytes(most + 1, '\0');
  in.read(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  if (in.bad() || !in.is_open()) throw config::Error(path + " cannot be read; the master's user needs the right to");
  bytes.resize(static_cast<std::size_t>(in.gcount()));
  return bytes;
}

/// Where an element of HTML would end, or another begin, within a script; nullptr: nowhere.
const char* markup_in(const std::string& script) {
  std::string lower(script.size(), '\0');
  std::transform(script.begin(), script.end(), lower.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  for (const char* const mark : {"</script", "<script", "<!--"})
    if (lower.find(mark) != std::string::npos) return mark;
  return nullptr;
}

struct Head {
  std::string title, driver;
};

/// Of the script's first line: // iotcloud page: {"title": "TurtleBot", "driver": "turtle"}
Head read_head(const std::string& script) {
  const auto line = script.substr(0, script.find('\n'));
  const auto remedy = fmt::format(R"(its first line is to be: {}{{"title": "TITLE", "driver": "DRIVER"}})", head_mark);
  if (!line.starts_with(head_mark)) throw config::Error("it does not say that it is a page; " + remedy);
  const auto json = discovery::parse_json(line.substr(head_mark.size()), "the first line", most_head_bytes);
  if (!json.is_object()) throw config::Error("its first line has no object; " + remedy);
  const auto text = [&](const char* key) {
    const auto found = json.find(key);
    if (found == json.end() || !found->is_string() || found->get<std::string>().empty())
      throw config::Error(fmt::format("its first line has no text \"{}\"; {}", key, remedy));
    return found->get<std::string>();
  };
  return {text("title"), text("driver")};
}

std::string base64_sha256(const std::string& text) {
  std::array<unsigned char, 32> digest{};
  std::array<unsigned char, 45> base64{};
  unsigned int size = 0;
  if (EVP_Digest(text.data(), text.size(), digest.data(), &size, EVP_sha256(), nullptr) != 1)
    throw config::Error("OpenSSL makes no SHA-256");
  EVP_EncodeBlock(base64.data(), digest.data(), static_cast<int>(size));
  return reinterpret_cast<const char*>(base64.data());
}

}  // namespace

std::map<std::string, std::string> PagePlugins::files() const {
  std::map<std::string, std::string> all;
  for (const auto& folder : settings_.folders) {
    std::error_code problem;
    for (auto entry = std::filesystem::directory_iterator(folder, problem);
         !problem && entry != std::filesystem::directory_iterator(); entry.increment(problem)) {
      if (entry->path().extension() == ending && is_name(entry->path().stem()))
        all.emplace(entry->path().stem(), entry->path());
    }
  }
  return all;
}

PagePlugins::Page PagePlugins::read(const std::string& name, const std::string& file) const {
  Page page;
  page.listed.name = name;
  page.listed.title = name;
  try {
    auto script = bytes_of(file, most_script_bytes);
    if (!script) throw config::Error("it was removed");
    if (script->size() > most_script_bytes)
      throw config::Error(fmt::format("it has more than {} bytes", most_script_bytes));
    // What it says of itself is read once its signature, if one is required, is known to be good.
    if (settings_.signers) {
      const auto signature = bytes_of(file + ".sig", security::most_plugin_signature_bytes).value_or("");
      const auto plugin = name + std::string(ending);
      page.listed.signed_by = settings_.signers->admit(plugin, *script, signature);
      if (settings_.versions && !page.listed.signed_by.empty())
        settings_.versions->admit(plugin, security::parse_plugin_signature(signature), false);
    }
    const auto [title, driver] = read_head(*script);
    page.listed.title = title;
    page.listed.driver = driver;
    if (const auto* const mark = markup_in(*script); mark != nullptr)
      throw config::Error(
          fmt::format("it has \"{}\", by which a browser ends or begins a script; in a text write it "
                      "in two parts",
                      mark));
    std::erase(*script, '\r');  // browsers read line ends so, before they look at the script's hash
    if (script->find('\0') != std::string::npos) throw config::Error("it has a byte 0, so it is no script");
    page.script = *std::move(script);
  } catch (const config::Error& error) {
    page.listed.problem = error.what();
  }
  note(page.listed);
  return page;
}

void PagePlugins::note(const Listed& page) const {
  const config::MutexLock lock(mutex_);
  auto& known = problems_[page.name];
  if (known != page.problem && !page.problem.empty())
    logger.warn("console: the page {} is not shown: {}", page.name, page.problem);
  known = page.problem;
}

std::vector<PagePlugins::Listed> PagePlugins::list() const {
  std::vector<Listed> all;
  for (const auto& [name, file] : files()) all.push_back(read(name, file).listed);
  return all;
}

PagePlugins::Document PagePlugins::document(const std::string& name) const {
  const auto known = files();
  const auto found = known.find(name);
  if (found == known.end()) throw config::Error(fmt::format("there is no page \"{}\"", name));
  const auto page = read(name, found->second);
  if (!page.listed.problem.empty()) throw config::Error(page.listed.problem);
  Document document;
  document.html =
      "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" "
      "content=\"width=device-width, initial-scale=1\"><title>Page of a robot</title></head><body><script>" +
      page.script + "</script></body></html>";
  document.policy = fmt::format(
      "default-src 'none'; script-src 'sha256-{}'; style-src 'unsafe-inline'; img-src data: blob:; base-uri 'none'; "
      "form-action 'none'; frame-ancestors 'self'; sandbox allow-scripts",
      base64_sha256(page.script));
  return document;
}

}  // namespace iotcloud::master
