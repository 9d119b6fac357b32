mod batch;
mod cold_start;
mod flights;
mod irregular;
