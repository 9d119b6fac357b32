mod batch;
mod cold_start;
mod fixes;
mod flights;
mod irregular;
