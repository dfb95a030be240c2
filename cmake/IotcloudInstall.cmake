# What authors of drivers, spouts and bolts use: find_package(iotcloud) with the targets iotcloud::drivers and
# iotcloud::topology, and the programs that run their plugins.
include(CMakePackageConfigHelpers)
include(GNUInstallDirs)

get_property(sdk_targets GLOBAL PROPERTY IOTCLOUD_SDK_TARGETS)
add_custom_target(installed)  # all that is installed, and no test
add_dependencies(installed programs sample_recording ${sdk_targets})
install(TARGETS ${sdk_targets} EXPORT iotcloudTargets
  ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR}
  FILE_SET HEADERS DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}
  INCLUDES DESTINATION ${CMAKE_INSTALL_INCLUDEDIR})
install(EXPORT iotcloudTargets NAMESPACE iotcloud:: DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/iotcloud)
# The site of ./dev docs, if it was made.
install(DIRECTORY ${PROJECT_SOURCE_DIR}/build/docs/site/ DESTINATION ${CMAKE_INSTALL_DOCDIR}/html OPTIONAL)
configure_package_config_file(${PROJECT_SOURCE_DIR}/cmake/iotcloudConfig.cmake.in
  ${PROJECT_BINARY_DIR}/iotcloudConfig.cmake INSTALL_DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/iotcloud)
write_basic_package_version_file(${PROJECT_BINARY_DIR}/iotcloudConfigVersion.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${PROJECT_BINARY_DIR}/iotcloudConfig.cmake ${PROJECT_BINARY_DIR}/iotcloudConfigVersion.cmake
  DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/iotcloud)
