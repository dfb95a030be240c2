#pragma once

#include <string>
#include <vector>

#include <iotcloud/topology/storm/job/job.h>

namespace iotcloud::topology::storm {

/// Where the parts of the jar are that come with this program.
struct ShimFiles {
  std::string classes;  ///< the jar of the Java classes
  std::string library;  ///< libiotcloud_storm.so

  /// Finds them in the build or the installation of the running program. \throws config::Error that says how to make
  /// what is missing.
  static ShimFiles find();
};

/// What is in a jar.
struct JarContents {
  std::vector<std::string> taken;     ///< paths of libraries that were put into it
  std::vector<std::string> expected;  ///< names of libraries that worker machines must have
};

/// Writes the jar of a job: the classes, the libraries with what they need (below resources/, from where Storm's
/// workers load them) and what they register, the topology's file, and the job itself for `storm jar`.
/// \param onto a jar whose contents go into it, too: components in Java and Python, and Flux; empty: none
/// \throws config::Error when it cannot be written, or two libraries have one name.
JarContents write_jar(const Job& job, const ShimFiles& shim, const std::string& file, const std::string& onto = "");

}  // namespace iotcloud::topology::storm
