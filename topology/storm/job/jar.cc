#include <deque>
#include <filesystem>
#include <map>
#include <memory>
#include <utility>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <zip.h>

#include <iotcloud/config/error.h>
#include <iotcloud/topology/storm/job/classes.h>
#include <iotcloud/topology/storm/job/jar.h>
#include <iotcloud/topology/storm/job/needed_libraries.h>
#include <iotcloud/topology/storm/shim/component_source.h>

namespace iotcloud::topology::storm {

namespace {

namespace fs = std::filesystem;

constexpr const char* classes_name = "iotcloud-storm.jar";
constexpr const char* library_name = "libiotcloud_storm.so";
// As Submit.java and Library.java read them.
constexpr const char* job_name = "iotcloud-job.json";
constexpr const char* topology_name = "iotcloud-topology.bin";
constexpr const char* classes_folder = "iotcloud-library/";

std::string find_file(const char* name, const std::vector<fs::path>& folders, const char* remedy) {
  std::string places;
  for (const fs::path& folder : folders) {
    if (fs::exists(folder / name)) return folder / name;
    places += (places.empty() ? "" : ", ") + folder.string();
  }
  throw config::Error(fmt::format("{} is not in {}; {}", name, places, remedy));
}

/// A jar that is read or, until finish(), written; without finish() the file stays as it was.
class Archive {
 public:
  explicit Archive(const std::string& file, int flags = 0) : file_(file) {
    int code = 0;
    archive_ = zip_open(file.c_str(), flags, &code);
    if (archive_ != nullptr) return;
    zip_error_t error;
    zip_error_init_with_code(&error, code);
    const std::string why = zip_error_strerror(&error);
    zip_error_fini(&error);
    throw config::Error(fmt::format("{} is no jar that can be used: {}", file, why));
  }
  ~Archive() {
    if (archive_ != nullptr) zip_discard(archive_);
  }
  Archive(const Archive&) = delete;
  Archive& operator=(const Archive&) = delete;

  // Each replaces an entry that has the name.
  void add_file(const std::string& name, const std::string& path) {
    add(name, zip_source_file(archive_, path.c_str(), 0, -1));
  }
  void add_text(const std::string& name, std::string text) {
    const std::string& kept = texts_.emplace_back(std::move(text));
    add(name, zip_source_buffer(archive_, kept.data(), kept.size(), 0));
  }
  /// The files of another jar, without what describes that jar.
  void add_files_of(const std::string& jar) {
    const Archive from(jar, ZIP_RDONLY);
    const auto count = static_cast<zip_uint64_t>(zip_get_num_entries(from.archive_, 0));
    for (zip_uint64_t i = 0; i < count; ++i) {
      const std::string name = zip_get_name(from.archive_, i, 0);
      if (!name.ends_with('/') && !name.starts_with("META-INF/")) add_text(name, from.text_of(i));
    }
  }
  void finish() {
    if (zip_close(archive_) != 0) fail("written");
    archive_ = nullptr;
  }

 private:
  void add(const std::string& name, zip_source_t* source) {
    if (source == nullptr) fail("written");
    const zip_int64_t entry = zip_file_add(archive_, name.c_str(), source, ZIP_FL_ENC_UTF_8 | ZIP_FL_OVERWRITE);
    if (entry < 0) {
      zip_source_free(source);
      fail("written");
    }
    constexpr int fast = 1;  // a jar is made for each submission, and libraries are most of it
    if (zip_set_file_compression(archive_, static_cast<zip_uint64_t>(entry), ZIP_CM_DEFLATE, fast) != 0)
      fail("written");
  }
  std::string text_of(zip_uint64_t entry) const {
    zip_stat_t stat;
    zip_file_t* file = zip_fopen_index(archive_, entry, 0);
    if (file == nullptr || zip_stat_index(archive_, entry, 0, &stat) != 0) fail("read");
    std::string text(stat.size, '\0');
    const zip_int64_t size = zip_fread(file, text.data(), stat.size);
    zip_fclose(file);
    if (size != static_cast<zip_int64_t>(stat.size)) fail("read");
    return text;
  }
  [[noreturn]] void fail(const char* what) const {
    throw config::Error(fmt::format("{} cannot be {}: {}", file_, what, zip_strerror(archive_)));
  }

  const std::string file_;
  std::deque<std::string> texts_;  ///< until finish() reads them
  zip_t* archive_ = nullptr;
};

}  // namespace

ShimFiles ShimFiles::find() {
  const fs::path program = fs::read_symlink("/proc/self/exe").parent_path();
  const fs::path prefix = program.parent_path();
  return {find_file(classes_name, {prefix / "share/iotcloud/storm", program.parent_path().parent_path() / "storm"},
                    "\"./dev storm jar\" makes it, with Maven"),
          find_file(library_name, {prefix / "lib/iotcloud/storm", program.parent_path() / "storm"},
                    "it is made where a JDK is installed (Debian: openjdk-17-jdk-headless)")};
}

JarContents write_jar(const Job& job, const ShimFiles& shim, const std::string& file, const std::string& onto) {
  std::vector<std::string> libraries = job.libraries;
  libraries.push_back(shim.library);
  const NeededLibraries needed = needed_libraries(libraries);
  std::map<std::string, std::string> resources;  // path by name
  for (const auto* paths : {&std::as_const(libraries), &needed.taken}) {
    for (const std::string& path : *paths) {
      const auto [known, fresh] = resources.emplace(fs::path(path).filename(), path);
      if (fresh || fs::equivalent(known->second, path)) continue;
      throw config::Error(
          fmt::format("{} and {} have one name; in the jar they would be one file", known->second, path));
    }
  }
  if (!onto.empty()) Archive(onto, ZIP_RDONLY);  // says so when it is none
  const fs::path partial = file + ".partial";
  std::error_code error;
  fs::copy_file(onto.empty() ? shim.classes : onto, partial, fs::copy_options::overwrite_existing, error);
  if (error) throw config::Error(fmt::format("{} cannot be written: {}", file, error.message()));
  Archive archive(partial);
  if (!onto.empty()) archive.add_files_of(shim.classes);
  for (const auto& [name, path] : resources) archive.add_file("resources/" + name, path);
  for (const std::string& library : job.libraries)
    archive.add_text(classes_folder + fs::path(library).filename().string() + ".json", classes_of(library));
  if (!job.file.empty()) {
    archive.add_file(std::string("resources/") + topology_file, job.file);
    archive.add_text(
        job_name, nlohmann::ordered_json{{"name", job.name}, {"conf", nlohmann::ordered_json::parse(job.conf)}}.dump());
    archive.add_text(topology_name, job.topology);
  }
  archive.finish();
  fs::rename(partial, file);
  return {needed.taken, needed.expected};
}

}  // namespace iotcloud::topology::storm
